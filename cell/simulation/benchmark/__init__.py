"""Measure accuracy and speed of recognition on simulated scans, for `pointchain bench`."""
