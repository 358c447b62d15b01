"""Calibration boards: geometry, rendering, printing, and detection in images."""
