"""Verification of a calibration after it was solved.

`verify` takes a calibration and new views of the board. It distinguishes a moved camera from a moved board.
`judge_drift` takes the hand-eye errors estimated from scans. It detects a camera that moved since the calibration.
"""

from calibration.verification.drift import Drift, ScanLikelihood, judge_drift
from calibration.verification.verification import Verification, VerificationView, verify

__all__ = ["Drift", "ScanLikelihood", "Verification", "VerificationView", "judge_drift", "verify"]
