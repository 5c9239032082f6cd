"""Measures the beam: identification, calibration, validation and comparison.

Each loads for its own command alone. In come a rig, or its twin, and an apparatus or a protocol;
out come apparatus and calibration files, figures and a page.
"""
