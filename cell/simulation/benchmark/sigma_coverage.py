"""Check `sigma_m` of recognition: 95 % of the chain points should lie within two sigma of the truth."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from cell.simulation.benchmark.intervals import clustered_interval
from cell.simulation.evaluation.curve_distance import Nearest
from cell.simulation.evaluation.metrics import true_lines


@dataclass(frozen=True)
class SigmaCounts:
    """Number of chain points of one model, and of those within two sigma of the true centre line."""

    seen: int = 0
    """Points that a view saw."""
    seen_within: int = 0
    bridged: int = 0
    """Points that no view saw (`views` 0)."""
    bridged_within: int = 0


def sigma_counts(model: Mapping[str, Any], truth: Mapping[str, Any]) -> SigmaCounts:
    """Count the points of one model (JSON, `pointchain/1`) within two sigma of its truth.

    The error of a point is its distance from the nearest true centre line. In a scene without a string, every point
    is outside.
    """
    chains = model["chains"]
    strings = true_lines(truth)
    points = np.array([point for chain in chains for point in chain["points"]], dtype=np.float64).reshape(-1, 3)
    sigma = np.array([value for chain in chains for value in chain["sigma_m"]], dtype=np.float64)
    seen = np.array([value for chain in chains for value in chain["views"]], dtype=np.int64) > 0
    within = np.zeros(len(points), dtype=bool)
    if strings and len(points):
        within = Nearest(strings).distance(points) <= 2.0 * sigma
    return SigmaCounts(
        seen=int(seen.sum()),
        seen_within=int((within & seen).sum()),
        bridged=int((~seen).sum()),
        bridged_within=int((within & ~seen).sum()),
    )


def sigma_shares(counts: Iterable[SigmaCounts]) -> dict[str, Any]:
    """Return the share of all points together, and of the seen and the bridged points.

    Args:
        counts: One entry for each model.

    Returns:
        `within_2_sigma` (0 to 1, None without a point), its 95 % interval `within_2_sigma_interval_95` and `n_points`;
        `seen` and `bridged` have the same members.
    """
    counted = list(counts)
    return {
        **_share([c.seen_within + c.bridged_within for c in counted], [c.seen + c.bridged for c in counted]),
        "seen": _share([c.seen_within for c in counted], [c.seen for c in counted]),
        "bridged": _share([c.bridged_within for c in counted], [c.bridged for c in counted]),
    }


def _share(within: Sequence[int], points: Sequence[int]) -> dict[str, Any]:
    total = sum(points)
    return {
        "within_2_sigma": round(sum(within) / total, 4) if total else None,
        "within_2_sigma_interval_95": clustered_interval(within, points),
        "n_points": total,
    }
