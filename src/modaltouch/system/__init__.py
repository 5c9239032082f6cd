"""What the computer gives to every room: clocks, locks between processes, signals, and which build this is."""
