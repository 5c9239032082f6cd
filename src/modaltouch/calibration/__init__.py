"""Calibration: the loop that makes the stimulus true on the very beam it is played on."""
