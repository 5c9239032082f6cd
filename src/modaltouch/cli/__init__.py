"""The command line: all that is printed, every exit status, and nothing else."""
