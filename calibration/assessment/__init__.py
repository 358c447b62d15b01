"""From a solved calibration to findings and a verdict."""
