"""Verification of a calibration after it was solved.

A calibration and new views of the board go into `verify`, which distinguishes a moved camera from a moved board. The
hand-eye errors that scans estimate go into `judge_drift`, which detects a camera that moved since the calibration.
"""

from calibration.verification.drift import Drift, ScanError, judge_drift
from calibration.verification.verification import Verification, VerifiedView, verify

__all__ = ["Drift", "ScanError", "Verification", "VerifiedView", "judge_drift", "verify"]
