"""Agreement of a point chain model with the truth of a simulated scan."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cell.simulation.evaluation.chain_matching import Pair, pair_up
from cell.simulation.evaluation.curve_distance import Line, Nearest

TOLERANCE_RADII = 4.0
"""Largest mean distance of a chain from its string, and of a crossing from its true position, in radii."""
CONFIDENT = 0.9


class ScoringError(ValueError):
    """A model or a truth lacks a value that is compared."""

    slug = "scoring"


@dataclass(frozen=True)
class Score:
    """Result of the comparison of one model with one truth.

    Distances are metres, or None without anything to compare.
    """

    name: str
    strings: int
    chains: int
    true_ends: int
    true_crossings: int
    crossings: int
    mean_m: float | None
    """Mean distance of the recognised lines from the true ones."""
    p95_m: float | None
    """95th percentile of this distance."""
    shape_m: float | None
    """Mean distance after the best rigid fit, which removes calibration errors."""
    end_m: float | None
    """Largest distance of a true end from the nearest recognised end."""
    cover: float
    """Share of the true lines with a recognised line within the radius of the string."""
    topology: bool
    """Whether strings, open or closed, the order of crossings along each, and every over and under are right."""
    confident_mistakes: int
    """Number of crossings with over and under exchanged at a confidence above 0.9."""


def score(model: Mapping[str, Any], truth: Mapping[str, Any]) -> Score:
    """Compare a model with a truth.

    Args:
        model: Model document of schema `pointchain/1`.
        truth: Truth document of `cell.simulation.scenes.ground_truth`. Without `radii`, all strings have `radius`.
            Without `closed`, all strings are open.

    Raises:
        ScoringError: One of them is not such a document.
    """
    try:
        name, radius = str(truth["name"]), float(truth["radius"])
        strings = true_lines(truth)
        radii = [float(r) for r in truth.get("radii") or [radius] * len(strings)]
        real = [_Crossing.of_truth(crossing) for crossing in truth["crossings"]]
        if len(radii) != len(strings):
            raise ValueError(f"{len(radii)} radii of {len(strings)} curves")
    except (KeyError, TypeError, ValueError, IndexError) as error:
        raise ScoringError(f"the truth is not a truth file's content: {error!r}") from error
    if "error" in model:
        raise ScoringError(f"{name}: there is no model but an error: {model['error']}")
    try:
        chains, numbers = _model_lines(model)
        found = [_Crossing.of_model(crossing, numbers) for crossing in model["crossings"]]
    except (KeyError, TypeError, ValueError) as error:
        raise ScoringError(f"{name}: the model is not of schema pointchain/1: {error!r}") from error
    pairs = pair_up(chains, strings)
    matches = [
        (m, n)
        for m, n in _match_crossings(found, real)
        if _apart(found[m], real[n]) < TOLERANCE_RADII * min(radii[string] for string, _ in real[n].strands)
    ]
    return Score(
        name,
        len(strings),
        len(chains),
        sum(2 for line in strings if not line.closed),
        len(real),
        len(found),
        *_line_errors(chains, strings),
        end_m=_end_error(chains, strings),
        cover=_cover(chains, strings, radii),
        topology=len(pairs) == len(strings) == len(chains)
        and all(_is_string(pair, chains, strings, radii) for pair in pairs.values())
        and len(matches) == len(found) == len(real)
        and _same_orders(found, real, dict(matches), pairs, strings),
        confident_mistakes=sum(
            found[m].confidence > CONFIDENT and _exchanged(found[m], real[n], pairs, strings) for m, n in matches
        ),
    )


def true_lines(truth: Mapping[str, Any]) -> list[Line]:
    """Return the centre lines of a truth."""
    curves = [np.array(curve, dtype=np.float64)[:, :3] for curve in truth["curves"]]
    closed = truth.get("closed") or [False] * len(curves)
    return [Line.of(curve, bool(is_closed)) for curve, is_closed in zip(curves, closed, strict=True)]


def _model_lines(model: Mapping[str, Any]) -> tuple[list[Line], dict[Any, int]]:
    """Return the chains that are lines, and the index of each chain's id."""
    chains = [chain for chain in model["chains"] if len(chain["points"]) > 1]
    lines = [
        Line.of(np.array(chain["points"], dtype=np.float64).reshape(-1, 3), chain.get("closed", False))
        for chain in chains
    ]
    return lines, {chain["id"]: k for k, chain in enumerate(chains)}


def _line_errors(
    chains: Sequence[Line], strings: Sequence[Line]
) -> tuple[float, float, float] | tuple[None, None, None]:
    """Return the mean and the 95th percentile of the distance, and the mean after the best rigid fit."""
    if not (chains and strings):
        return None, None, None
    nearest = Nearest(strings)
    recognised = np.vstack([chain.dense() for chain in chains])
    distance = nearest.distance(recognised)
    moved = recognised
    for _ in range(5):
        moved = _fitted(moved, nearest.points(moved))
    return float(distance.mean()), float(np.percentile(distance, 95)), float(nearest.distance(moved).mean())


def _fitted(points: NDArray[np.float64], targets: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return `points` (N, 3) after the best rigid fit to `targets` (N, 3) in the least-squares sense (Kabsch)."""
    centre, goal = points.mean(axis=0), targets.mean(axis=0)
    u, _, vt = np.linalg.svd((targets - goal).T @ (points - centre))
    # the rotation about a straight string is undetermined; the sign excludes a reflection
    R = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
    return (points - centre) @ R.T + goal


def _cover(chains: Sequence[Line], strings: Sequence[Line], radii: Sequence[float]) -> float:
    if not strings:
        return 1.0
    if not chains:
        return 0.0
    nearest = Nearest(chains)
    return float(
        np.concatenate([nearest.distance(line.dense()) < r for line, r in zip(strings, radii, strict=True)]).mean()
    )


def _end_error(chains: Sequence[Line], strings: Sequence[Line]) -> float | None:
    true, recognised = (
        np.array([end for line in lines if not line.closed for end in (line.points[0], line.points[-1])])
        for lines in (strings, chains)
    )
    if not (len(true) and len(recognised)):
        return None
    return float(np.linalg.norm(true[:, None] - recognised[None], axis=2).min(axis=1).max())


def _is_string(pair: Pair, chains: Sequence[Line], strings: Sequence[Line], radii: Sequence[float]) -> bool:
    near = pair.apart_m < TOLERANCE_RADII * radii[pair.string]
    return near and chains[pair.chain].closed == strings[pair.string].closed


@dataclass(frozen=True)
class _Crossing:
    """A crossing of lines, numbered as in their list. A strand is a line and an arc length."""

    x_m: float
    y_m: float
    over: tuple[int, float]
    under: tuple[int, float]
    confidence: float = 1.0

    @property
    def strands(self) -> tuple[tuple[int, float], tuple[int, float]]:
        return self.over, self.under

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


def _apart(a: _Crossing, b: _Crossing) -> float:
    return float(np.hypot(a.x_m - b.x_m, a.y_m - b.y_m))


def _match_crossings(found: Sequence[_Crossing], real: Sequence[_Crossing]) -> list[tuple[int, int]]:
    """Return the pairs (recognised, true) with the smallest sum of distances."""
    from scipy.optimize import linear_sum_assignment

    if not (found and real):
        return []
    rows, columns = linear_sum_assignment([[_apart(a, b) for b in real] for a in found])
    return [(int(m), int(n)) for m, n in zip(rows, columns, strict=True)]


def _same_orders(
    found: Sequence[_Crossing],
    real: Sequence[_Crossing],
    names: Mapping[int, int],
    pairs: Mapping[int, Pair],
    strings: Sequence[Line],
) -> bool:
    """Return whether every string has the same crossings in the same order and roles. All chains have a pair.

    The order along a closed string is cyclic.
    """
    true: list[list[tuple[float, int, int]]] = [[] for _ in strings]
    met: list[list[tuple[float, int, int]]] = [[] for _ in strings]
    for k, crossing in enumerate(real):
        for role, (string, s) in enumerate(crossing.strands):
            true[string].append((s, k, role))
    for k, crossing in enumerate(found):
        for role, (chain, s) in enumerate(crossing.strands):
            met[pairs[chain].string].append((pairs[chain].on_string(s), names[k], role))
    for line, a, b in zip(strings, true, met, strict=True):
        wanted, given = ([passing[1:] for passing in sorted(passings)] for passings in (a, b))
        turns = range(max(len(given), 1)) if line.closed else range(1)
        if not any(given[turn:] + given[:turn] == wanted for turn in turns):
            return False
    return True


def _exchanged(found: _Crossing, real: _Crossing, pairs: Mapping[int, Pair], strings: Sequence[Line]) -> bool:
    """Return whether the recognised over strand is the true under strand, and vice versa."""
    if not all(chain in pairs for chain, _ in found.strands):
        return False
    over, under = ((pairs[chain].string, pairs[chain].on_string(s)) for chain, s in found.strands)
    if real.over[0] != real.under[0]:
        return (over[0], under[0]) == (real.under[0], real.over[0])

    def along(a: tuple[int, float], b: tuple[int, float]) -> float:
        line, apart = strings[a[0]], abs(a[1] - b[1])
        return min(apart, line.length_m - apart) if line.closed else apart

    right = along(over, real.over) + along(under, real.under)
    return over[0] == under[0] == real.over[0] and right > along(over, real.under) + along(under, real.over)
