"""Folders of calibration images with flange poses, and the observations read from them."""
