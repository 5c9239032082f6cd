"""What is kept: the append-only session log, the only truth, and the BIDS view derived from it."""
