"""Grasp candidates: positions along a chain where the gripper could grasp if no obstacle were near."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from recognition.geometry.polyline import unit_vectors
from recognition.grasping.gripper import Gripper
from recognition.model.chains import Chain, ChainInterpolator, Crossing, passes_below
from recognition.parameters import ChainParameters

STEP_M = 0.005
"""Distance between neighbouring positions along a chain, metres."""
MAX_POSITIONS_PER_CHAIN = 100
"""Maximum number of positions on a chain. On a long chain, positions are farther apart than `STEP_M`."""
MAX_RELEVANT_DISTANCE_M = 0.03
"""Maximum distance, metres, at which an end, a crossing or an obstacle influences a grasp."""
FULL_SCORE_VIEWS = 3
"""Minimum number of views for the full visibility score."""
MIN_SLOPE_COSINE = 0.5
"""Minimum cosine of the slope of a string that can be grasped from above (60 degrees)."""
NO_ROOM = "where the gripper would touch the table, another strand or an object, or where the table was not measured"
"""Reason for positions that could be grasped if no obstacle were near, but have no grasp."""
ROUNDING_M = 1e-9
"""Tolerance for rounding errors, metres."""


@dataclass(frozen=True, eq=False)
class GraspCandidates:
    """N grasp candidates on one chain."""

    s_m: NDArray[np.float64]
    """(N,) arc length along the chain, metres."""
    point: NDArray[np.float64]
    """(N, 3) points on the centre line, metres, base frame."""
    direction: NDArray[np.float64]
    """(N, 3) chain directions projected onto the table plane, unit vectors, base frame."""
    opening_m: NDArray[np.float64]
    """(N,) opening of the gripper that each candidate needs, metres."""
    base_score: NDArray[np.float64]
    """(N,) score without the factors for clearance, reach and tilt."""


def find_candidates(
    chain: Chain, crossings: Sequence[Crossing], parameters: ChainParameters, gripper: Gripper
) -> tuple[GraspCandidates | None, str]:
    """Return the positions along a chain that could be grasped if no obstacle were near.

    Args:
        chain: Chain to grasp.
        crossings: Crossings of all chains.
        parameters: Method parameters; uses the radius r and the extent r_cn of an intersection.
        gripper: Dimensions of the gripper.

    Returns:
        The candidates, and the reason to report if no candidate becomes a grasp. The candidates are None if the chain
        is not longer than the width of a finger.
    """
    line, length, half, r = ChainInterpolator(chain), chain.length_m, gripper.finger_width_m / 2, chain.radius_m
    if len(chain.points) < 2 or length <= 2 * half:
        return None, f"its length of {length * 1000:.0f} mm is not more than the width of a finger"
    first, last = (0.0, length) if chain.closed else (half, length - half)
    count = int(np.clip(np.floor((last - first + ROUNDING_M) / STEP_M) + 1, 1, MAX_POSITIONS_PER_CHAIN))
    s = np.linspace(first, last, count, endpoint=not chain.closed)
    passes = [p.s_m for x in crossings for p in (x.over, x.under) if p.chain == chain.id]
    below = [p.s_m for p, _ in passes_below(chain, crossings)]
    window = s[:, None] + np.linspace(-half, half, 9)
    n_views = line(window, chain.views.astype(np.float64)).min(axis=1)
    margin = line.nearest_distance(s, below) - half - parameters.r_cn / parameters.r * r

    point = line(s, chain.points)
    h = max(half, r)
    before, after = point - line(s - h, chain.points), line(s + h, chain.points) - point
    tangent, straightness = unit_vectors(before + after), (unit_vectors(before) * unit_vectors(after)).sum(axis=1)
    slope_cosine = np.hypot(tangent[:, 0], tangent[:, 1])
    direction = unit_vectors(tangent * (1.0, 1.0, 0.0))
    offset = line(window, chain.points) - point[:, None]
    bend = np.abs(offset[..., 1] * direction[:, None, 0] - offset[..., 0] * direction[:, None, 1]).max(axis=1)
    sigma = line(window, chain.sigma_m).max(axis=1)
    opening = 2 * (r + 2 * sigma + bend) + gripper.opening_margin_m

    to_end = np.full(count, np.inf) if chain.closed else np.minimum(s, length - s) - half
    to_nearest = np.minimum(to_end, line.nearest_distance(s, passes))
    score = np.minimum(n_views / FULL_SCORE_VIEWS, 1) * (
        0.5 + 0.5 * np.clip(to_nearest / MAX_RELEVANT_DISTANCE_M, 0, 1)
    )
    score *= np.clip(straightness, 0, 1) * slope_cosine
    score /= 1 + (2 * sigma / r) ** 2

    suitable, counts = np.ones(count, dtype=bool), []
    needed, stroke = opening.min() * 1000, gripper.stroke_m * 1000
    for passes, reason in (
        (n_views >= 1, "not seen by any view"),
        (margin >= 0, "underneath another strand at a crossing, or beside it"),
        (slope_cosine > MIN_SLOPE_COSINE, "too steep"),
        (
            opening <= gripper.stroke_m,
            f"too wide: they need an opening of at least {needed:.1f} mm, and the gripper opens {stroke:.1f} mm",
        ),
    ):
        counts.append((np.count_nonzero(suitable & ~passes), reason))
        suitable &= passes
    counts.append((np.count_nonzero(suitable), NO_ROOM))
    reasons = "; ".join(f"{number} are {reason}" for number, reason in counts if number)
    candidates = GraspCandidates(s[suitable], point[suitable], direction[suitable], opening[suitable], score[suitable])
    return candidates, f"of {count} positions along it, {reasons}"
