"""Measured effect of both drive laws on a beam, as in Fig. 2 and 5 to 8 of the paper."""
