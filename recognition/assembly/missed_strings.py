"""Doubts about surface that may be a string that no strand follows."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from recognition.messages import format_position
from recognition.model.findings import Finding, finding
from recognition.parameters import ChainParameters

MIN_LENGTH_RADII = 20.0
"""Minimum size of a piece of surface that may be a string, in radii. Shorter ones are mostly parts of objects."""
MAX_SCATTER_RADII = 1.1
"""Maximum standard deviation of the surface across a piece, in radii, as its median. That of a string is 0.58, or 0.9
if windows widen it, and that of a wide object 1.5."""
SCATTER_RADIUS_RADII = 3.0
"""Radius of the neighbourhood in which it is measured, in radii."""
SAMPLE_COUNT = 200
"""Maximum number of points at which it is measured."""
MAX_HEIGHT_RADII = 2.2
"""Maximum median height of the surface above the table, in radii. That of a resting string is below 2."""
FOLLOWED_RADII = 2.0
"""Distance up to which a strand follows the surface, in radii."""
DOUBTED_RADII = 4.0
"""Distance from the surface of a piece up to which an excluded string belongs to it, in radii."""
MAX_FOLLOWED_SHARE = 0.3
"""Maximum share of a piece that a strand follows. A followed piece was a strand and has a finding of its own."""


def missed_string_findings(
    pieces: Sequence[NDArray[np.float64]],
    lines: Sequence[NDArray[np.float64]],
    doubted: Sequence[NDArray[np.float64]],
    parameters: ChainParameters,
    table_z_m: float,
) -> list[Finding]:
    """Return a doubt about each piece of unexplained surface that is as long, narrow and low as a string.

    Args:
        pieces: (M, 3) points of each piece of surface that belongs to no chain, metres, base frame.
        lines: (N, 3) points of all fitted strands, also of the excluded ones, metres, base frame.
        doubted: (3,) positions of excluded pieces that have the doubt already, metres, base frame.
        parameters: Method parameters; uses the radius r.
        table_z_m: Height of the table, metres, base frame.
    """
    findings: list[Finding] = []
    for piece in pieces:
        length_m = float(np.linalg.norm(np.ptp(piece, axis=0)))
        if length_m < MIN_LENGTH_RADII * parameters.r or not _is_like_string(piece, parameters.r, table_z_m):
            continue
        if _followed_share(piece, lines, parameters.r) > MAX_FOLLOWED_SHARE:
            continue
        if doubted and KDTree(piece).query(np.array(doubted))[0].min() < DOUBTED_RADII * parameters.r:
            continue
        centre = piece.mean(axis=0)
        message = (
            f"something of {length_m * 1000:.0f} mm at {format_position(centre)} is as narrow and as low as a string "
            "and in no chain: look at it, or scan again with viewpoints that are nearer"
        )
        findings.append(finding("possible-string", message, point=centre, value=length_m))
    return findings


def _is_like_string(piece: NDArray[np.float64], r: float, table_z_m: float) -> bool:
    """Return whether a piece (N, 3) is as narrow and as low as strings of radius r, seen from above."""
    if np.median(piece[:, 2]) - table_z_m > MAX_HEIGHT_RADII * r:
        return False
    xy = piece[:, :2]
    sample = xy[:: -(-len(xy) // SAMPLE_COUNT)]
    neighbours = KDTree(xy).query_ball_point(sample, SCATTER_RADIUS_RADII * r)
    scatter = [np.linalg.eigvalsh(np.cov(xy[near].T))[0] for near in neighbours if len(near) > 2]
    return len(scatter) > 0 and float(np.sqrt(max(np.median(scatter), 0.0))) <= MAX_SCATTER_RADII * r


def _followed_share(piece: NDArray[np.float64], lines: Sequence[NDArray[np.float64]], r: float) -> float:
    """Return the share of the points (N, 3) of a piece that are near one of the lines."""
    if not lines:
        return 0.0
    distance, _ = KDTree(np.vstack(lines)).query(piece, distance_upper_bound=FOLLOWED_RADII * r)
    return float(np.isfinite(distance).mean())
