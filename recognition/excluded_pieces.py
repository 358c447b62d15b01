"""Findings on pieces that recognition excludes, because they are no strings or too short."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from recognition.messages import format_position
from recognition.model.finding_types import FindingCode
from recognition.model.findings import Finding, finding

MAX_LISTED_PIECES = 10
"""Maximum number of excluded pieces with their own note. One more note gives the number of further pieces."""


def excluded_piece(code: FindingCode, points: NDArray[np.float64], length_m: float, reason: str) -> Finding:
    """Return the finding on an excluded piece.

    Args:
        code: Code of the finding.
        points: (N, 3) points of the piece, metres, base frame.
        length_m: Length of the piece, metres.
        reason: Why the piece was excluded, and what to do if it may be a string.
    """
    centre = points.mean(axis=0)
    possible = ", although it may be a string" if code == "possible-string" else ""
    message = f"excluded a piece of {length_m * 1000:.0f} mm at {format_position(centre)}{possible}: {reason}"
    return finding(code, message, point=centre, value=length_m)


def shortened(excluded: Sequence[Finding]) -> list[Finding]:
    """Return the first `MAX_LISTED_PIECES` findings on excluded pieces, and one that sums up the further pieces."""
    listed = list(excluded[:MAX_LISTED_PIECES])
    further = excluded[MAX_LISTED_PIECES:]
    if further:
        lengths_mm = [1000 * (found.value or 0.0) for found in further]
        longest = np.array(further[int(np.argmax(lengths_mm))].point_m)
        message = (
            f"excluded {len(further)} more pieces, {min(lengths_mm):.0f} to {max(lengths_mm):.0f} mm long, the longest "
            f"at {format_position(longest)}"
        )
        listed.append(finding("more-pieces", message, point=longest, value=len(further)))
    return listed
