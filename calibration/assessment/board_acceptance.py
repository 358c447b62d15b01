"""Acceptance of the board: compare the estimated size with the nominal size, and check its uncertainty."""

from calibration.assessment.evidence import Evidence
from calibration.result import Finding

MAX_SCALE_CHANGE = 0.003
"""Maximum deviation of the board scale from 1. It is 1 mm at 0.35 m. A larger deviation means a scaled print."""
MAX_SCALE_SIGMAS = 4.0
"""Maximum deviation of the board scale that noise may cause, in standard deviations."""
MAX_SCALE_SIGMA = 0.0015
"""Maximum standard deviation of a verified board scale. The prior standard deviation is slightly larger."""
UNVERIFIED_SCALE_SIGMA = 0.005
"""Assumed standard deviation of an unverified board scale, 1 mm in 200 mm with a ruler. The scale of a print that was
fitted to its paper deviates more; the check line of the print shows this deviation."""


def board_findings(evidence: Evidence) -> tuple[Finding, ...]:
    """Return the findings about the size of the board.

    Args:
        evidence: Solution and views of the calibration.
    """
    findings = []
    scale = evidence.board_scale
    sigma = evidence.board_scale_sigma
    limit = max(MAX_SCALE_CHANGE, MAX_SCALE_SIGMAS * sigma)
    if not abs(scale - 1.0) <= limit:
        findings.append(
            Finding(
                "board-scale",
                f"by the views, the size of the board differs by {100 * (scale - 1.0):+.2f} % from the given one, and "
                f"at most {100 * limit:.2f} % is accepted: print the board true to scale (100 %, not fitted to the "
                "page), measure it with a caliper over many squares, and give the measured pitch",
                blocking=True,
            )
        )
    if is_scale_unverified(evidence):
        findings.append(
            Finding(
                "board-scale-unverified",
                f"the views determine the size of the board to {100 * sigma:.2f} % only, and "
                f"{100 * MAX_SCALE_SIGMA:.2f} % is needed to verify it: measure the board with a caliper, or add "
                "views from a second distance",
                blocking=False,
            )
        )
    return tuple(findings)


def is_scale_unverified(evidence: Evidence) -> bool:
    """Return whether the views determine the board scale too imprecisely.

    Args:
        evidence: Solution and views of the calibration.
    """
    return not evidence.board_scale_sigma <= MAX_SCALE_SIGMA
