"""Changes between two models of the same table: matched chains, new chains, and chains that are gone."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from recognition.geometry.polyline import close_polyline, resample
from recognition.model.chains import Chain
from recognition.model.line_alignment import LineAlignment, align_lines

Change = Literal["unmoved", "moved", "deformed"]
"""What happened to a chain. `moved`: it kept its shape. `deformed`: its shape has changed."""

LENGTH_SIGMA_SHARE = 0.01
"""Standard deviation of the difference of two measured lengths, as a share of the length. `LENGTH_SIGMA_M` is added."""
LENGTH_SIGMA_M = 0.002
"""Part of this standard deviation that does not depend on the length, metres."""
RADIUS_SIGMA_SHARE = 0.1
"""Standard deviation of the difference of two measured radii, as a share of the radius."""
SHAPE_SIGMA_RADII = 0.5
"""Standard deviation of the distance of two measurements of one line, in radii. Grasps tolerate such a distance."""
DEFORMED_SIGMA_SHARE = 0.2
"""Standard deviation of the distance of a deformed line from its former shape, as a share of its length."""
MOVED_COST = 6.0
"""Cost of a moved chain, in squared sigmas, because most strings stay where they are."""
DEFORMED_COST = 12.0
"""Cost of a deformed chain, in squared sigmas."""
UNMATCHED_COST = 36.0
"""Cost of a chain that is gone and another one that is new, in squared sigmas. A match must cost less."""
OPEN_ENDED_WEIGHT = 0.05
"""Weight of the length difference if an end of one of the chains is not free: its length is only a lower limit."""


@dataclass(frozen=True, eq=False)
class ChainMatch:
    """A chain that is in both models."""

    chain: int
    """Id of the chain in the model now."""
    before: int
    """Id of the chain in the model before."""
    change: Change
    """What happened to it."""
    T_now_before: NDArray[np.float64]
    """(4, 4) rigid motion, metres, base frame. It maps points of the string before to points now. The identity if the
    string is unmoved; an approximation if it is deformed."""
    rms_m: float
    """Root mean square distance from the line before after the motion, metres."""
    displacement_m: float
    """Largest distance of a point of the string before from the same point now, metres."""
    is_reversed: bool
    """Whether the chain now runs in the opposite direction."""
    s_offset_m: float
    """Arc length, on a closed chain now, of the first point before, metres. 0 on open chains."""
    confidence: float
    """Probability that it is the same string, 0 to 1. Strings of equal length and radius that both moved give 0.5."""


@dataclass(frozen=True)
class ModelChanges:
    """Changes from one model to another."""

    matches: tuple[ChainMatch, ...]
    """Chains in both models, in the order of their ids now."""
    new: tuple[int, ...]
    """Ids of the chains that are only in the model now."""
    gone: tuple[int, ...]
    """Ids of the chains that are only in the model before."""


@dataclass(frozen=True, eq=False)
class _Candidate:
    """A possible match, and its cost in squared sigmas."""

    cost: float
    change: Change
    alignment: LineAlignment


def compare_chains(before: Sequence[Chain], now: Sequence[Chain]) -> ModelChanges:
    """Match the chains of two models by length, radius, place and shape.

    The assignment has the least total cost. A string keeps its length and radius. Its place and shape cost nothing if
    it is unmoved, `MOVED_COST` if it moved as a whole, and `DEFORMED_COST` if its shape changed.

    Args:
        before: Chains of the earlier model.
        now: Chains of the later model.
    """
    # Imported here, because SciPy takes half a second to load, and most users of a model do not compare it.
    from scipy.optimize import linear_sum_assignment

    candidates = {(i, j): _candidate(before[i], now[j]) for i, j in np.ndindex(len(before), len(now))}
    cost = np.empty((len(before), len(now)))
    for pair, candidate in candidates.items():
        cost[pair] = candidate.cost
    rows, columns = linear_sum_assignment(np.minimum(cost, UNMATCHED_COST))
    pairs = [(i, j) for i, j in zip(rows.tolist(), columns.tolist(), strict=True) if cost[i, j] < UNMATCHED_COST]
    matches = [_match(before[i], now[j], candidates[i, j], _confidence(cost, i, j)) for i, j in pairs]
    found_before = {i for i, _ in pairs}
    found_now = {j for _, j in pairs}
    return ModelChanges(
        matches=tuple(sorted(matches, key=lambda match: match.chain)),
        new=tuple(chain.id for j, chain in enumerate(now) if j not in found_now),
        gone=tuple(chain.id for i, chain in enumerate(before) if i not in found_before),
    )


def _candidate(before: Chain, now: Chain) -> _Candidate:
    """Return the cheapest explanation of two chains as one string."""
    length = max(before.length_m, now.length_m)
    radius = max(before.radius_m, now.radius_m)
    alignment = align_lines(before, now, SHAPE_SIGMA_RADII * radius)
    if before.closed != now.closed:
        return _Candidate(np.inf, "deformed", alignment)
    is_whole = all(end == "free" for end in (*before.ends, *now.ends))
    length_sigmas = abs(before.length_m - now.length_m) / (LENGTH_SIGMA_SHARE * length + LENGTH_SIGMA_M)
    radius_sigmas = abs(before.radius_m - now.radius_m) / (RADIUS_SIGMA_SHARE * radius)
    identity = (1.0 if is_whole else OPEN_ENDED_WEIGHT) * length_sigmas**2 + radius_sigmas**2
    shape_sigma = SHAPE_SIGMA_RADII * radius
    costs: dict[Change, float] = {
        "unmoved": (_distance(before, now) / shape_sigma) ** 2,
        "moved": MOVED_COST + (alignment.rms_m / shape_sigma) ** 2,
        "deformed": DEFORMED_COST + (alignment.rms_m / (DEFORMED_SIGMA_SHARE * length)) ** 2,
    }
    change = min(costs, key=lambda key: costs[key])
    return _Candidate(identity + costs[change], change, alignment)


def _distance(before: Chain, now: Chain) -> float:
    """Return the root mean square distance of the shorter chain from the longer one where they lie, metres."""
    from scipy.spatial import KDTree

    shorter, longer = sorted((before, now), key=lambda chain: chain.length_m)
    lines = [resample(close_polyline(chain.points, chain.closed), chain.radius_m / 8) for chain in (shorter, longer)]
    distance, _ = KDTree(lines[1]).query(lines[0])
    return float(np.sqrt(np.mean(np.asarray(distance) ** 2)))


def _confidence(cost: NDArray[np.float64], i: int, j: int) -> float:
    """Return the probability of a match among all matches of its two chains and no match."""
    others = np.concatenate([np.delete(cost[i], j), np.delete(cost[:, j], i), [UNMATCHED_COST]])
    return float(1 / (1 + np.exp(np.clip(cost[i, j] - others, -700, 700) / 2).sum()))


def _match(before: Chain, now: Chain, candidate: _Candidate, confidence: float) -> ChainMatch:
    alignment = candidate.alignment
    T_now_before = alignment.T_now_before
    rms_m = alignment.rms_m
    if candidate.change == "unmoved":
        T_now_before = np.eye(4)
        rms_m = _distance(before, now)
    return ChainMatch(
        chain=now.id,
        before=before.id,
        change=candidate.change,
        T_now_before=T_now_before,
        rms_m=rms_m,
        displacement_m=alignment.displacement_m,
        is_reversed=alignment.is_reversed,
        s_offset_m=alignment.s_offset_m,
        confidence=confidence,
    )
