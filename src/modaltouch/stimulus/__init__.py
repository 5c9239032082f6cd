"""The physics of the stimulus: from a wished velocity field to the codes of a generator, and back. NumPy only."""
