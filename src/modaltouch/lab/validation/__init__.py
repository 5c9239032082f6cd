"""Shows what a drive does to a beam, as the paper does in Fig. 2 and 5 to 8, for both drive laws side by side."""
