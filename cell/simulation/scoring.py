"""How well a point chain model agrees with the truth of a simulated scan."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cell.simulation.shapes import polyline_length
from recognition.model import arc_length

DENSE_M = 0.0005
"""Lines are compared at points this far apart."""
COMPARED = 200
"""Points of a chain and a string that are compared to find out which belong together."""
TOLERANCE_RADII = 4.0
"""How far a chain may be from its string on average, or a crossing from its true place, to be taken for it."""
CONFIDENT = 0.9

Curve = NDArray[np.float64]


class ScoringError(ValueError):
    """A model or truth that lacks what is compared."""

    slug = "scoring"


@dataclass(frozen=True)
class Score:
    """One model against one truth. Distances are metres, None where the model has no chain."""

    name: str
    strings: int
    chains: int
    true_crossings: int
    crossings: int
    mean_m: float | None
    """Mean distance of the recognised lines from the true ones."""
    p95_m: float | None
    """Its 95th percentile."""
    shape_m: float | None
    """The mean distance after the best rigid fit: what no calibration could spoil."""
    end_m: float | None
    """The largest distance of a true end from the nearest recognised one."""
    cover: float
    """Share of the true lines that has a recognised line within r."""
    topology: bool
    """Strings, the order of crossings along each, and every over and under are right."""
    confident_mistakes: int
    """Crossings that have over and under exchanged with a confidence above 0.9."""


def score(model: Mapping[str, Any], truth: Mapping[str, Any]) -> Score:
    """Compares a model (JSON, `pointchain/1`) with a truth (JSON, `cell.simulation.truth`).

    Raises:
        ScoringError: one of them is not such a document; for a model that is an error document it says so.
    """
    try:
        radius = float(truth["radius"])
        strings = [np.array(curve, dtype=np.float64)[:, :3] for curve in truth["curves"]]
        real = [_Crossing.of_truth(crossing) for crossing in truth["crossings"]]
        name = str(truth["name"])
    except (KeyError, TypeError, ValueError, IndexError) as error:
        raise ScoringError(f"the truth is not a truth file's content: {error!r}") from error
    if "error" in model:
        raise ScoringError(f"{name}: there is no model but an error: {model['error']}")
    try:
        lines = [chain for chain in model["chains"] if len(chain["points"]) > 1]
        numbers = {chain["id"]: k for k, chain in enumerate(lines)}
        chains = [np.array(chain["points"], dtype=np.float64).reshape(-1, 3) for chain in lines]
        found = [_Crossing.of_model(crossing, numbers) for crossing in model["crossings"]]
    except (KeyError, TypeError, ValueError) as error:
        raise ScoringError(f"{name}: the model is not of schema pointchain/1: {error!r}") from error
    counts = (name, len(strings), len(chains), len(real), len(found))
    if not chains:
        return Score(*counts, None, None, None, None, cover=0.0, topology=False, confident_mistakes=0)
    pairing = _Pairing.best(strings, chains)
    tolerance = TOLERANCE_RADII * radius
    matches = _match_crossings(found, real)
    mean, p95, shape, cover = _line_errors(strings, chains, radius)
    return Score(
        *counts,
        mean_m=mean,
        p95_m=p95,
        shape_m=shape,
        end_m=_end_error(strings, chains),
        cover=cover,
        topology=len(found) == len(real)
        and pairing.complete(len(strings), len(chains), tolerance)
        and all(_apart(found[m], real[n]) < tolerance for m, n in matches)
        and _sequences(found, dict(matches), pairing) == _sequences(real, None, None),
        confident_mistakes=sum(
            _exchanged(found[m], real[n], pairing)
            for m, n in matches
            if found[m].confidence > CONFIDENT and _apart(found[m], real[n]) < tolerance
        ),
    )


def _line_errors(
    strings: Sequence[Curve], chains: Sequence[Curve], radius_m: float
) -> tuple[float, float, float, float]:
    """Mean, 95th percentile and, after the best rigid fit, mean distance to the true lines; and the cover."""
    from scipy.spatial import KDTree

    true = np.vstack([_dense(string) for string in strings])
    recognised = np.vstack([_dense(chain) for chain in chains])
    tree = KDTree(true)
    distance = tree.query(recognised)[0]
    moved = recognised
    for _ in range(5):
        moved = _fitted(moved, true[tree.query(moved)[1]])
    cover = (KDTree(recognised).query(true)[0] < radius_m).mean()
    return (
        float(distance.mean()),
        float(np.percentile(distance, 95)),
        float(tree.query(moved)[0].mean()),
        float(cover),
    )


def _fitted(points: Curve, targets: Curve) -> Curve:
    """`points` (N, 3) moved rigidly to lie nearest to `targets` (N, 3) in the least squares sense (Kabsch)."""
    centre, goal = points.mean(axis=0), targets.mean(axis=0)
    u, _, vt = np.linalg.svd((targets - goal).T @ (points - centre))
    # A straight string leaves the turn about itself open; the sign keeps the fit from mirroring.
    R = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
    return (points - centre) @ R.T + goal


def _end_error(strings: Sequence[Curve], chains: Sequence[Curve]) -> float:
    true = np.array([end for string in strings for end in (string[0], string[-1])])
    recognised = np.array([end for chain in chains for end in (chain[0], chain[-1])])
    return float(np.linalg.norm(true[:, None] - recognised[None], axis=2).min(axis=1).max())


@dataclass(frozen=True)
class _Crossing:
    """A crossing of lines, numbered as in their list."""

    x_m: float
    y_m: float
    over: tuple[int, float]
    under: tuple[int, float]
    confidence: float = 1.0

    @classmethod
    def of_truth(cls, crossing: Mapping[str, Any]) -> "_Crossing":
        (over, s_over), (under, s_under) = crossing["over"], crossing["under"]
        x, y = crossing["point"][:2]
        return cls(float(x), float(y), (int(over), float(s_over)), (int(under), float(s_under)))

    @classmethod
    def of_model(cls, crossing: Mapping[str, Any], numbers: Mapping[Any, int]) -> "_Crossing":
        over, under = (
            (numbers[strand["chain"]], float(strand["s_m"])) for strand in (crossing["over"], crossing["under"])
        )
        x, y = crossing["point"][:2]
        return cls(float(x), float(y), over, under, float(crossing.get("confidence", 1.0)))


@dataclass(frozen=True)
class _Pairing:
    """Which string each chain is."""

    string: Mapping[int, int]
    """By chain; chains beyond the number of strings have none."""
    backwards: Mapping[int, bool]
    """Whether the chain runs against its string."""
    apart_m: Mapping[int, float]
    """Mean distance of the two at equal shares of their lengths."""
    length_m: Mapping[int, float]
    """The chain's length."""

    @classmethod
    def best(cls, strings: Sequence[Curve], chains: Sequence[Curve]) -> "_Pairing":
        """The pairing of least distance in sum."""
        from scipy.optimize import linear_sum_assignment

        true = [_sampled(string, COMPARED) for string in strings]
        recognised = [_sampled(chain, COMPARED) for chain in chains]
        # (direction, chain, string)
        cost = np.array(
            [
                [[np.linalg.norm(chain[::way] - string, axis=1).mean() for string in true] for chain in recognised]
                for way in (1, -1)
            ]
        )
        least = cost.min(axis=0)
        pairs = [(int(j), int(i)) for j, i in zip(*linear_sum_assignment(least), strict=True)]
        return cls(
            dict(pairs),
            {j: bool(cost[1, j, i] < cost[0, j, i]) for j, i in pairs},
            {j: float(least[j, i]) for j, i in pairs},
            {j: polyline_length(chains[j]) for j, _ in pairs},
        )

    def complete(self, strings: int, chains: int, tolerance_m: float) -> bool:
        return strings == chains and all(apart < tolerance_m for apart in self.apart_m.values())

    def on_string(self, strand: tuple[int, float]) -> tuple[int, float] | None:
        """A place on a chain as string and arc length along that."""
        chain, s = strand
        if chain not in self.string:
            return None
        return self.string[chain], self.length_m[chain] - s if self.backwards[chain] else s


def _sampled(curve: Curve, count: int) -> Curve:
    s = arc_length(curve)
    return np.column_stack([np.interp(np.linspace(0.0, s[-1], count), s, curve[:, k]) for k in range(3)])


def _dense(curve: Curve) -> Curve:
    return _sampled(curve, max(round(polyline_length(curve) / DENSE_M), 2) + 1)


def _apart(a: _Crossing, b: _Crossing) -> float:
    return float(np.hypot(a.x_m - b.x_m, a.y_m - b.y_m))


def _match_crossings(found: Sequence[_Crossing], real: Sequence[_Crossing]) -> list[tuple[int, int]]:
    """Pairs (recognised, true) of least distance in sum."""
    from scipy.optimize import linear_sum_assignment

    if not (found and real):
        return []
    rows, columns = linear_sum_assignment([[_apart(a, b) for b in real] for a in found])
    return [(int(m), int(n)) for m, n in zip(rows, columns, strict=True)]


def _sequences(
    crossings: Sequence[_Crossing], names: Mapping[int, int] | None, pairing: _Pairing | None
) -> dict[int, list[tuple[int, str]]]:
    """For each string with crossings, in its direction, which crossing it meets, as over or under strand.

    `names` and `pairing` bring recognised crossings to true numbers, strings and directions.
    """
    met: dict[int, list[tuple[float, int, str]]] = {}
    for k, crossing in enumerate(crossings):
        for role, strand in (("over", crossing.over), ("under", crossing.under)):
            place = strand if pairing is None else pairing.on_string(strand)
            if place is not None:
                met.setdefault(place[0], []).append((place[1], k if names is None else names[k], role))
    return {string: [(k, role) for _, k, role in sorted(passes)] for string, passes in met.items()}


def _exchanged(found: _Crossing, real: _Crossing, pairing: _Pairing) -> bool:
    """Whether the recognised over strand is the true under strand and the other way round."""
    over, under = pairing.on_string(found.over), pairing.on_string(found.under)
    if over is None or under is None:
        return False
    if real.over[0] != real.under[0]:
        return (over[0], under[0]) == (real.under[0], real.over[0])
    right = abs(over[1] - real.over[1]) + abs(under[1] - real.under[1])
    return over[0] == under[0] == real.over[0] and right > abs(over[1] - real.under[1]) + abs(under[1] - real.over[1])
