"""Acceptance of the board: whether it has the given size, and whether the views verify that."""

from calibration.assessment.evidence import Evidence
from calibration.result import Finding

MAX_SCALE_CHANGE = 0.003
"""Maximum deviation of the size of the board, as a share. It is 1 mm at 0.35 m. More means a print that was scaled."""
MAX_SCALE_SIGMAS = 4.0
"""Deviation of the size of the board, in sigmas, that noise may cause."""
MAX_SCALE_SIGMA = 0.0015
"""Maximum sigma of the size of the board, as a share, that counts as verified. The prior has a little more."""
UNVERIFIED_SCALE_SIGMA = 0.005
"""Assumed sigma of the size of the board, as a share, if the views have not verified it: 1 mm in 200 mm by a ruler. A
print that was scaled to fit its paper is farther off; its check line shows that."""


def board_findings(evidence: Evidence) -> tuple[Finding, ...]:
    """Return the findings about the size of the board.

    Args:
        evidence: The solution and the views that it was solved from.
    """
    findings = []
    scale, sigma = evidence.board_scale, evidence.board_scale_sigma
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
    """Return whether the views do not determine the size of the board well enough.

    Args:
        evidence: The solution and the views that it was solved from.
    """
    return not evidence.board_scale_sigma <= MAX_SCALE_SIGMA
