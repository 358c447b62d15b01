"""Calibrations over HTTP: their rows, their run, what is told of them, and what scans tell of the one in use."""
