"""Measurement of fingers on a beam: excitation, recordings, and the file of fingers."""
