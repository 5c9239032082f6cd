"""The physics of the stimulus: from a wished velocity field to a generator's codes, and back. NumPy only."""
