"""Count the chain points within two sigma of the truth.

If `sigma_m` of the chain points is right, about 95 % of the points lie within two sigma of the true centre line.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from cell.simulation.benchmark.intervals import clustered_interval
from cell.simulation.evaluation.curve_distance import NearestPoints
from cell.simulation.evaluation.metrics import true_lines


@dataclass(frozen=True)
class SigmaCounts:
    """Numbers of chain points of one model."""

    seen: int = 0
    """Number of points that at least one view saw."""
    seen_within: int = 0
    """Number of seen points within two sigma of the true centre line."""
    bridged: int = 0
    """Number of points that no view saw (`views` is 0)."""
    bridged_within: int = 0
    """Number of bridged points within two sigma of the true centre line."""


def sigma_counts(model: Mapping[str, Any], truth: Mapping[str, Any]) -> SigmaCounts:
    """Count the chain points of one model within two sigma of the truth.

    The error of a point is its distance from the nearest true centre line. In a scene without strings, no point is
    within two sigma.

    Args:
        model: Model document of schema `pointchain/2`.
        truth: Truth document of `cell.simulation.scenes.ground_truth`.

    Returns:
        Counts of the model.
    """
    chains = model["chains"]
    strings = true_lines(truth)
    points = np.array([point for chain in chains for point in chain["points"]], dtype=np.float64).reshape(-1, 3)
    sigma = np.array([value for chain in chains for value in chain["sigma_m"]], dtype=np.float64)
    seen = np.array([value for chain in chains for value in chain["views"]], dtype=np.int64) > 0
    within = np.zeros(len(points), dtype=bool)
    if strings and len(points):
        within = NearestPoints(strings).distance(points) <= 2.0 * sigma
    return SigmaCounts(
        seen=int(seen.sum()),
        seen_within=int((within & seen).sum()),
        bridged=int((~seen).sum()),
        bridged_within=int((within & ~seen).sum()),
    )


def sigma_shares(counts: Iterable[SigmaCounts]) -> dict[str, Any]:
    """Return the shares of the points within two sigma, for all points, seen points and bridged points.

    Args:
        counts: Counts of each model.

    Returns:
        `within_2_sigma` is the share (0 to 1), `within_2_sigma_interval_95` is its 95 % interval, and `n_points` is the
        number of points. Without points, the first two are None. `seen` and `bridged` have the same members.
    """
    counted = list(counts)
    return {
        **_share([c.seen_within + c.bridged_within for c in counted], [c.seen + c.bridged for c in counted]),
        "seen": _share([c.seen_within for c in counted], [c.seen for c in counted]),
        "bridged": _share([c.bridged_within for c in counted], [c.bridged for c in counted]),
    }


def _share(within: Sequence[int], points: Sequence[int]) -> dict[str, Any]:
    """Return the share, its interval and the number of points, from the counts of each model."""
    total = sum(points)
    return {
        "within_2_sigma": round(sum(within) / total, 4) if total else None,
        "within_2_sigma_interval_95": clustered_interval(within, points),
        "n_points": total,
    }
