"""The laws of this program and their rivals: the same beam, the same voltage limit, the same recordings."""
