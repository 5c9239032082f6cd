"""The laws of this program beside their rivals: one beam, one voltage limit, the same recordings to learn from."""
