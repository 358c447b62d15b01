"""Scans, calibrations and verifications, one at a time, from acceptance to final state."""
