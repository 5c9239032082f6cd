"""Shows what a drive does to a beam, as in Fig. 2 and 5 to 8 of the paper, for both drive laws side by side."""
