"""What speaks against a calibration that was just solved, by the views that were held out."""

from calibration.result import Finding
from calibration.verification.verification import Verification, format_discrepancy


def verification_findings(verification: Verification) -> tuple[Finding, ...]:
    """None where it holds. Nobody has moved the board since, so that one that seems moved speaks against it too."""
    if not verification.views:
        words = f"{verification.words}, so that it is not verified: take a verification, or calibrate anew"
        return (Finding("not-verified", words, refuses=False),)
    if verification.passed and verification.board_moved_m is None:
        return ()
    off = format_discrepancy(verification.worst_m, verification.worst_rad)
    expected = format_discrepancy(verification.expected_m, verification.expected_rad)
    words = (
        f"on poses that were held out the board appears {off} off, where about {expected} are expected: see that "
        "board, camera and bracket are firm, and calibrate anew"
    )
    return (Finding("verification-failed", words, refuses=True),)
