"""Probes fingers on a beam: what is played and recorded, and the file of what was found."""
