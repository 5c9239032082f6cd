"""Identification of a bare beam's modes, as in section III-B of the paper, on a rig or from files."""
