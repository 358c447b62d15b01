"""The hand-eye calibration as a JSON document and as a file."""
