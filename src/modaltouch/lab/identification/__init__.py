"""From a bare beam to its table of modes: section III-B of the paper, on a rig or from files."""
