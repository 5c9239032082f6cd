"""Plays the burst: the generator over PyVISA, and its simulated twin behind the same driver."""
