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
FINGER_SAMPLES = 9
"""Number of points along a chain, over the width of a finger, at which the chain is read."""


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

    def select(self, chosen: NDArray[np.int64] | NDArray[np.bool_]) -> "GraspCandidates":
        """Return the candidates with the given indices, or those where a mask is True."""
        return GraspCandidates(
            self.s_m[chosen],
            self.point[chosen],
            self.direction[chosen],
            self.opening_m[chosen],
            self.base_score[chosen],
        )


@dataclass(frozen=True, eq=False)
class _Posture:
    """How a string lies at N positions along its chain."""

    point: NDArray[np.float64]
    """(N, 3) points on the centre line, metres, base frame."""
    direction: NDArray[np.float64]
    """(N, 3) chain directions projected onto the table plane, unit vectors, base frame."""
    slope_cosine: NDArray[np.float64]
    """(N,) cosine of the slope of the string."""
    bend_cosine: NDArray[np.float64]
    """(N,) cosine of the angle between the directions before and after the position."""


@dataclass(frozen=True, eq=False)
class _Requirement:
    """A requirement on the N positions along a chain."""

    is_met: NDArray[np.bool_]
    """(N,) mask of the positions that meet it."""
    reason: str
    """Reason against the others, after "they are"."""


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
    half = gripper.finger_width_m / 2
    if len(chain.points) < 2 or chain.length_m <= 2 * half:
        return None, f"its length of {chain.length_m * 1000:.0f} mm is not more than the width of a finger"
    r = chain.radius_m
    line = ChainInterpolator(chain)
    s = _positions(chain, half)
    posture = _measure_posture(line, s, max(half, r))
    window = finger_window(s, gripper)
    n_views = line(window, chain.views.astype(np.float64)).min(axis=1)
    sigma = line(window, chain.sigma_m).max(axis=1)

    offset = line(window, chain.points) - posture.point[:, None]
    direction = posture.direction[:, None]
    bend = np.abs(offset[..., 1] * direction[..., 0] - offset[..., 0] * direction[..., 1]).max(axis=1)
    opening = 2 * (r + 2 * sigma + bend) + gripper.opening_margin_m

    to_nearest = _distance_to_end_or_crossing(line, s, crossings, half)
    score = np.minimum(n_views / FULL_SCORE_VIEWS, 1) * half_to_one(to_nearest / MAX_RELEVANT_DISTANCE_M)
    score *= np.clip(posture.bend_cosine, 0, 1) * posture.slope_cosine
    score /= 1 + (2 * sigma / r) ** 2

    below = [own.s_m for own, _ in passes_below(chain, crossings)]
    margin = line.nearest_distance(s, below) - half - parameters.r_cn / parameters.r * r
    min_opening_mm = opening.min() * 1000
    too_wide = (
        f"too wide: they need an opening of at least {min_opening_mm:.1f} mm, and the gripper opens "
        f"{gripper.stroke_m * 1000:.1f} mm"
    )
    requirements = [
        _Requirement(n_views >= 1, "not seen by any view"),
        _Requirement(margin >= 0, "underneath another strand at a crossing, or beside it"),
        _Requirement(posture.slope_cosine > MIN_SLOPE_COSINE, "too steep"),
        _Requirement(opening <= gripper.stroke_m, too_wide),
    ]
    suitable = np.all([requirement.is_met for requirement in requirements], axis=0)
    candidates = GraspCandidates(s, posture.point, posture.direction, opening, score)
    return candidates.select(suitable), f"of {len(s)} positions along it, {_count_reasons(requirements)}"


def finger_window(s: NDArray[np.float64], gripper: Gripper) -> NDArray[np.float64]:
    """Return arc lengths (N, K) along a chain under a finger at each of the arc lengths `s` (N,), metres."""
    half = gripper.finger_width_m / 2
    return s[:, None] + np.linspace(-half, half, FINGER_SAMPLES)


def half_to_one(share: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return score factors (N,) that rise from 0.5 at a share of 0 to 1 at a share of 1 and more."""
    return 0.5 + 0.5 * np.clip(share, 0, 1)


def _positions(chain: Chain, half_finger_m: float) -> NDArray[np.float64]:
    """Return the arc lengths (N,) of the positions on a chain, metres. A finger does not reach beyond an open end."""
    first = 0.0
    last = chain.length_m
    if not chain.closed:
        first = half_finger_m
        last = chain.length_m - half_finger_m
    count = int(np.clip(np.floor((last - first + ROUNDING_M) / STEP_M) + 1, 1, MAX_POSITIONS_PER_CHAIN))
    return np.linspace(first, last, count, endpoint=not chain.closed)


def _measure_posture(line: ChainInterpolator, s: NDArray[np.float64], reach_m: float) -> _Posture:
    """Return how the string lies at the arc lengths `s` (N,). Directions are measured over `reach_m` on each side."""
    points = line.chain.points
    point = line(s, points)
    before = point - line(s - reach_m, points)
    after = line(s + reach_m, points) - point
    tangent = unit_vectors(before + after)
    return _Posture(
        point=point,
        direction=unit_vectors(tangent * (1.0, 1.0, 0.0)),
        slope_cosine=np.hypot(tangent[:, 0], tangent[:, 1]),
        bend_cosine=(unit_vectors(before) * unit_vectors(after)).sum(axis=1),
    )


def _distance_to_end_or_crossing(
    line: ChainInterpolator, s: NDArray[np.float64], crossings: Sequence[Crossing], half_finger_m: float
) -> NDArray[np.float64]:
    """Return the distances (N,) along the chain from a finger to an end, or from `s` to a crossing, the smaller one."""
    chain = line.chain
    sides = [*(crossing.over for crossing in crossings), *(crossing.under for crossing in crossings)]
    to_crossing = line.nearest_distance(s, [side.s_m for side in sides if side.chain == chain.id])
    if chain.closed:
        return to_crossing
    return np.minimum(np.minimum(s, chain.length_m - s) - half_finger_m, to_crossing)


def _count_reasons(requirements: Sequence[_Requirement]) -> str:
    """Return how many positions have no grasp for which reason.

    Each position counts for the first requirement that it does not meet, or else for `NO_ROOM`.
    """
    is_suitable = np.ones(len(requirements[0].is_met), dtype=bool)
    reasons = []
    for requirement in requirements:
        count = np.count_nonzero(is_suitable & ~requirement.is_met)
        if count:
            reasons.append(f"{count} are {requirement.reason}")
        is_suitable &= requirement.is_met
    if is_suitable.any():
        reasons.append(f"{np.count_nonzero(is_suitable)} are {NO_ROOM}")
    return "; ".join(reasons)
