"""Checks of the camera, the observations and the motion before a calibration is solved."""
