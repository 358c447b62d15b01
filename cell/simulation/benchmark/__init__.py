"""How right and how fast recognition is on simulated scans, in one command: `pointchain bench`."""
