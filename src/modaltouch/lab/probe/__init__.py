"""Probes fingers on a beam: excitation, recordings, and the file of the fingers found."""
