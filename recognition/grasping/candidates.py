"""Places along a chain that a gripper could take if nothing else were there."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from recognition.grasping.gripper import Gripper
from recognition.model.interpolation import ChainInterpolator
from recognition.model.model import Chain, Crossing
from recognition.parameters import ChainParameters

STEP_M = 0.005
"""Distance of places along a chain ..."""
MOST_PER_CHAIN = 100
"""... unless that would be more than so many: then they are farther apart, all along the chain."""
FAR_M = 0.03
"""What is farther away than this does not matter."""
ENOUGH_VIEWS = 3
"""Views that make a place as good as any."""
SURE = 0.9
"""Below this confidence either strand of a crossing may be the one underneath."""
LEVEL = 0.5
"""Cosine of the steepest slope at which a string can be taken from above."""
ROUNDING_M = 1e-9
"""What rounding may cost."""


@dataclass(frozen=True, eq=False)
class GraspCandidates:
    """Places along a chain; one row each."""

    s_m: NDArray[np.float64]
    point: NDArray[np.float64]
    along: NDArray[np.float64]
    """(N, 3) unit vectors: the chain's direction, made horizontal."""
    opening_m: NDArray[np.float64]
    merit: NDArray[np.float64]
    """Score but for clearance and way of approach."""


def find_candidates(
    chain: Chain, crossings: Sequence[Crossing], parameters: ChainParameters, gripper: Gripper
) -> tuple[GraspCandidates | None, str]:
    """Places that could be grasped if nothing else were there; and why there is none, or no grasp at them."""
    line, length, half, r = ChainInterpolator(chain), chain.length_m, gripper.finger_width_m / 2, chain.radius_m
    if len(chain.points) < 2 or length <= 2 * half:
        return None, f"its {length * 1000:.0f} mm are no longer than a finger is wide"
    first, last = (0.0, length) if chain.closed else (half, length - half)
    count = int(np.clip(np.floor((last - first + ROUNDING_M) / STEP_M) + 1, 1, MOST_PER_CHAIN))
    s = np.linspace(first, last, count, endpoint=not chain.closed)
    window = s[:, None] + np.linspace(-half, half, 9)
    seen = line(window, chain.views.astype(np.float64)).min(axis=1)
    beside = _from_under_passes(line, s, crossings) - half - parameters.r_cn / parameters.r * r

    point = line(s, chain.points)
    h = max(half, r)
    before, behind = point - line(s - h, chain.points), line(s + h, chain.points) - point
    tangent, straight = _unit(before + behind), (_unit(before) * _unit(behind)).sum(axis=1)
    level = np.hypot(tangent[:, 0], tangent[:, 1])
    along = _unit(tangent * (1.0, 1.0, 0.0))
    offset = line(window, chain.points) - point[:, None]
    bend = np.abs(offset[..., 1] * along[:, None, 0] - offset[..., 0] * along[:, None, 1]).max(axis=1)
    sigma = line(window, chain.sigma_m).max(axis=1)
    opening = 2 * (r + 2 * sigma + bend) + gripper.opening_margin_m

    to_end = np.full(count, np.inf) if chain.closed else np.minimum(s, length - s) - half
    near = np.minimum(to_end, _from_passes(line, s, crossings))
    merit = np.minimum(seen / ENOUGH_VIEWS, 1) * (0.5 + 0.5 * np.clip(near / FAR_M, 0, 1))
    merit *= np.clip(straight, 0, 1) * level
    merit /= 1 + (2 * sigma / r) ** 2

    good, reasons = np.ones(count, dtype=bool), []
    needed, stroke = opening.min() * 1000, gripper.stroke_m * 1000
    for fine, reason in (
        (seen >= 1, "not seen by any view"),
        (beside >= 0, "underneath another strand at a crossing, or beside it"),
        (level > LEVEL, "too steep"),
        (opening <= gripper.stroke_m, f"too wide: from {needed:.1f} mm on, and the gripper opens {stroke:.1f} mm"),
    ):
        reasons.append((np.count_nonzero(good & ~fine), reason))
        good &= fine
    reasons.append((np.count_nonzero(good), "where the gripper would touch the table, another strand or a thing"))
    told = "; ".join(f"{number} are {reason}" for number, reason in reasons if number)
    told = f"of {count} places along it {told}"
    return GraspCandidates(s[good], point[good], along[good], opening[good], merit[good]), told


def _from_passes(line: ChainInterpolator, s: NDArray[np.float64], crossings: Sequence[Crossing]) -> NDArray[np.float64]:
    """(N,) distances along the chain to its nearest pass through a crossing; infinite without one."""
    passes = [p.s_m for x in crossings for p in (x.over, x.under) if p.chain == line.chain.id]
    return np.min([np.full(len(s), np.inf), *(line.apart(s, t) for t in passes)], axis=0)


def _from_under_passes(
    line: ChainInterpolator, s: NDArray[np.float64], crossings: Sequence[Crossing]
) -> NDArray[np.float64]:
    """The same for passes underneath."""
    passes = [x.under for x in crossings] + [x.over for x in crossings if x.confidence < SURE]
    below = [line.apart(s, p.s_m) for p in passes if p.chain == line.chain.id]
    return np.min([np.full(len(s), np.inf), *below], axis=0)


def _unit(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-12)
