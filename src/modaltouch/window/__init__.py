"""Asks the participant: the PsychoPy window, and a simulated participant behind the same interface."""
