"""Whether recognition's `sigma_m` is honest: 95 % of chain points should lie within two of them of the truth."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from cell.simulation.lines import Nearest
from cell.simulation.scoring import true_lines


@dataclass(frozen=True)
class SigmaCounts:
    """Chain points, and how many of them lie within two sigma of the true centre line; seen or bridged ones."""

    seen: int = 0
    seen_within: int = 0
    bridged: int = 0
    """Points that no view saw (`views` 0)."""
    bridged_within: int = 0


def sigma_counts(model: Mapping[str, Any], truth: Mapping[str, Any]) -> SigmaCounts:
    """The counts of one model (JSON, `pointchain/1`) against its truth.

    A point's error is its distance from the nearest true centre line. Where the scene holds no string, every
    point is outside.
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
    """All of them together: `within_2_sigma` (0 to 1, None where there is no point) and `n_points`, whole and split."""
    counted = list(counts)
    seen, bridged = sum(c.seen for c in counted), sum(c.bridged for c in counted)
    seen_within, bridged_within = sum(c.seen_within for c in counted), sum(c.bridged_within for c in counted)
    return {
        **_share(seen_within + bridged_within, seen + bridged),
        "seen": _share(seen_within, seen),
        "bridged": _share(bridged_within, bridged),
    }


def _share(within: int, points: int) -> dict[str, Any]:
    return {"within_2_sigma": round(within / points, 4) if points else None, "n_points": points}
