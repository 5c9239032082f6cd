"""Comparison of the drive laws with other methods, on the same beam, voltage limit and recordings."""
