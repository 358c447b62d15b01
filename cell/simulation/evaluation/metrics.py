"""Score a point chain model by the truth of a simulated scan."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cell.simulation.evaluation.chain_matching import ChainMatch, match_chains
from cell.simulation.evaluation.curve_distance import NearestPoints, Polyline

TOLERANCE_RADII = 4.0
"""Maximum mean distance of a chain from its string, as a multiple of the radius of the string. It is also the maximum
distance in x and y of a crossing from its true position, as a multiple of the smaller radius."""
CONFIDENCE_THRESHOLD = 0.9
"""Confidence above which a crossing with over and under exchanged is a confident mistake."""


class ScoringError(ValueError):
    """The model or the truth is not a valid document."""

    slug = "scoring"


@dataclass(frozen=True)
class Score:
    """Result of the comparison of one model with one truth.

    Distances are in metres. A distance is None if the model or the truth has nothing to measure it from.
    """

    name: str
    """Name of the true scene."""
    strings: int
    """Number of true strings."""
    chains: int
    """Number of recognised chains with at least two points."""
    true_ends: int
    """Number of ends of true strings. A closed string has none."""
    true_crossings: int
    """Number of true crossings."""
    crossings: int
    """Number of recognised crossings."""
    mean_m: float | None
    """Mean distance of points on the recognised lines from the true lines."""
    p95_m: float | None
    """95th percentile of the same distances."""
    shape_m: float | None
    """Mean distance after a rigid fit of all recognised lines to the true lines, which removes calibration errors."""
    end_m: float | None
    """Largest distance of a true end from the nearest recognised end."""
    cover: float
    """Share of the true lines, 0 to 1, that has a recognised line within the radius of the string."""
    topology: bool
    """Whether the model has the true strings (open or closed), the true order of crossings along each string, and the
    true over and under at each crossing."""
    confident_mistakes: int
    """Number of crossings with over and under exchanged and a confidence above 0.9."""


def score(model: Mapping[str, Any], truth: Mapping[str, Any]) -> Score:
    """Compare a model with a truth.

    Args:
        model: Model document of schema `pointchain/2`.
        truth: Truth document of `cell.simulation.scenes.ground_truth`, in the frame of the model. Without `radii`, all
            strings have `radius`. Without `closed`, all strings are open.

    Returns:
        The score of the model.

    Raises:
        ScoringError: The model is an error document or not of schema `pointchain/2`, or the truth is not a truth
            document.
    """
    try:
        name, radius = str(truth["name"]), float(truth["radius"])
        strings = true_lines(truth)
        radii = [float(r) for r in truth.get("radii") or [radius] * len(strings)]
        real = [_Crossing.of_truth(crossing) for crossing in truth["crossings"]]
        if len(radii) != len(strings):
            raise ValueError(f"there are {len(radii)} radii for {len(strings)} curves")
    except (KeyError, TypeError, ValueError, IndexError) as error:
        raise ScoringError(f"the truth is not a truth document of `pointchain simulate`: {error!r}") from error
    if "error" in model:
        raise ScoringError(f"{name}: the document has an error instead of a model: {model['error']}")
    try:
        chains, index_of_id = _model_lines(model)
        found = [_Crossing.of_model(crossing, index_of_id) for crossing in model["crossings"]]
    except (KeyError, TypeError, ValueError) as error:
        raise ScoringError(f"{name}: the model is not of schema pointchain/2: {error!r}") from error
    pairs = match_chains(chains, strings)
    matches = [
        (m, n)
        for m, n in _match_crossings(found, real)
        if _distance_m(found[m], real[n]) < TOLERANCE_RADII * min(radii[string] for string, _ in real[n].strands)
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
        cover=_coverage(chains, strings, radii),
        topology=len(pairs) == len(strings) == len(chains)
        and all(_matches_string(pair, chains, strings, radii) for pair in pairs.values())
        and len(matches) == len(found) == len(real)
        and _has_true_order(found, real, dict(matches), pairs, strings),
        confident_mistakes=sum(
            found[m].confidence > CONFIDENCE_THRESHOLD and _is_exchanged(found[m], real[n], pairs, strings)
            for m, n in matches
        ),
    )


def true_lines(truth: Mapping[str, Any]) -> list[Polyline]:
    """Return the centre lines of the strings in a truth document."""
    curves = [np.array(curve, dtype=np.float64)[:, :3] for curve in truth["curves"]]
    closed = truth.get("closed") or [False] * len(curves)
    return [Polyline.of(curve, bool(is_closed)) for curve, is_closed in zip(curves, closed, strict=True)]


def _model_lines(model: Mapping[str, Any]) -> tuple[list[Polyline], dict[Any, int]]:
    """Return the chains with at least two points, and the index of each chain by its id."""
    chains = [chain for chain in model["chains"] if len(chain["points"]) > 1]
    lines = [
        Polyline.of(np.array(chain["points"], dtype=np.float64).reshape(-1, 3), chain.get("closed", False))
        for chain in chains
    ]
    return lines, {chain["id"]: k for k, chain in enumerate(chains)}


def _line_errors(
    chains: Sequence[Polyline], strings: Sequence[Polyline]
) -> tuple[float, float, float] | tuple[None, None, None]:
    """Return the mean and the 95th percentile of the distances, and the mean after the best rigid fit, metres."""
    if not (chains and strings):
        return None, None, None
    nearest = NearestPoints(strings)
    recognised = np.vstack([chain.densely_sampled() for chain in chains])
    distance = nearest.distance(recognised)
    moved = recognised
    for _ in range(5):
        moved = _fit_rigidly(moved, nearest.points(moved))
    return float(distance.mean()), float(np.percentile(distance, 95)), float(nearest.distance(moved).mean())


def _fit_rigidly(points: NDArray[np.float64], targets: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return `points` (N, 3) after the least-squares rigid fit to `targets` (N, 3) (Kabsch)."""
    centre, goal = points.mean(axis=0), targets.mean(axis=0)
    u, _, vt = np.linalg.svd((targets - goal).T @ (points - centre))
    # For a straight string, the rotation about its axis is undetermined. The determinant excludes a mirrored solution.
    R = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
    return (points - centre) @ R.T + goal


def _coverage(chains: Sequence[Polyline], strings: Sequence[Polyline], radii: Sequence[float]) -> float:
    """Return the share of the true lines, 0 to 1, that has a recognised line within the radius of the string."""
    if not strings:
        return 1.0
    if not chains:
        return 0.0
    nearest = NearestPoints(chains)
    return float(
        np.concatenate(
            [nearest.distance(line.densely_sampled()) < r for line, r in zip(strings, radii, strict=True)]
        ).mean()
    )


def _end_error(chains: Sequence[Polyline], strings: Sequence[Polyline]) -> float | None:
    """Return the largest distance of a true end from the nearest recognised end, metres."""
    true, recognised = (
        np.array([end for line in lines if not line.closed for end in (line.points[0], line.points[-1])])
        for lines in (strings, chains)
    )
    if not (len(true) and len(recognised)):
        return None
    return float(np.linalg.norm(true[:, None] - recognised[None], axis=2).min(axis=1).max())


def _matches_string(
    pair: ChainMatch, chains: Sequence[Polyline], strings: Sequence[Polyline], radii: Sequence[float]
) -> bool:
    """Return whether a chain is near its string, and both are open or both are closed."""
    near = pair.mean_distance_m < TOLERANCE_RADII * radii[pair.string]
    return near and chains[pair.chain].closed == strings[pair.string].closed


@dataclass(frozen=True)
class _Crossing:
    """Crossing of two strands. A strand is the index of a line and the arc length along the line in metres."""

    x_m: float
    y_m: float
    over: tuple[int, float]
    under: tuple[int, float]
    confidence: float = 1.0
    """Probability that over and under are right, 0 to 1."""

    @property
    def strands(self) -> tuple[tuple[int, float], tuple[int, float]]:
        """The over strand and the under strand."""
        return self.over, self.under

    @classmethod
    def of_truth(cls, crossing: Mapping[str, Any]) -> "_Crossing":
        """Read a crossing of a truth document."""
        (over, s_over), (under, s_under) = crossing["over"], crossing["under"]
        x, y = crossing["point"][:2]
        return cls(float(x), float(y), (int(over), float(s_over)), (int(under), float(s_under)))

    @classmethod
    def of_model(cls, crossing: Mapping[str, Any], index_of_id: Mapping[Any, int]) -> "_Crossing":
        """Read a crossing of a model document. `index_of_id` has the index of each chain by its id."""
        over, under = (
            (index_of_id[strand["chain"]], float(strand["s_m"])) for strand in (crossing["over"], crossing["under"])
        )
        x, y = crossing["point"][:2]
        return cls(float(x), float(y), over, under, float(crossing.get("confidence", 1.0)))


def _distance_m(a: _Crossing, b: _Crossing) -> float:
    """Return the distance of two crossings in x and y, metres."""
    return float(np.hypot(a.x_m - b.x_m, a.y_m - b.y_m))


def _match_crossings(found: Sequence[_Crossing], real: Sequence[_Crossing]) -> list[tuple[int, int]]:
    """Return pairs of indices (recognised, true) such that the sum of the distances is smallest."""
    from scipy.optimize import linear_sum_assignment

    if not (found and real):
        return []
    rows, columns = linear_sum_assignment([[_distance_m(a, b) for b in real] for a in found])
    return [(int(m), int(n)) for m, n in zip(rows, columns, strict=True)]


def _has_true_order(
    found: Sequence[_Crossing],
    real: Sequence[_Crossing],
    true_index: Mapping[int, int],
    pairs: Mapping[int, ChainMatch],
    strings: Sequence[Polyline],
) -> bool:
    """Return whether each string has the true crossings in the true order, each with the true role (over or under).

    Every chain must have a pair. The order along a closed string is cyclic.

    Args:
        found: Recognised crossings.
        real: True crossings.
        true_index: Index of the true crossing, by the index of the recognised crossing.
        pairs: Pair of each matched chain, by the index of the chain.
        strings: True lines.
    """
    true: list[list[tuple[float, int, int]]] = [[] for _ in strings]
    recognised_passings: list[list[tuple[float, int, int]]] = [[] for _ in strings]
    for k, crossing in enumerate(real):
        for role, (string, s) in enumerate(crossing.strands):
            true[string].append((s, k, role))
    for k, crossing in enumerate(found):
        for role, (chain, s) in enumerate(crossing.strands):
            recognised_passings[pairs[chain].string].append((pairs[chain].arc_length_on_string(s), true_index[k], role))
    for line, a, b in zip(strings, true, recognised_passings, strict=True):
        expected, actual = ([passing[1:] for passing in sorted(passings)] for passings in (a, b))
        shifts = range(max(len(actual), 1)) if line.closed else range(1)
        if not any(actual[shift:] + actual[:shift] == expected for shift in shifts):
            return False
    return True


def _is_exchanged(
    found: _Crossing, real: _Crossing, pairs: Mapping[int, ChainMatch], strings: Sequence[Polyline]
) -> bool:
    """Return whether the recognised over strand is the true under strand, and the under strand the true over strand."""
    if not all(chain in pairs for chain, _ in found.strands):
        return False
    over, under = ((pairs[chain].string, pairs[chain].arc_length_on_string(s)) for chain, s in found.strands)
    if real.over[0] != real.under[0]:
        return (over[0], under[0]) == (real.under[0], real.over[0])

    def along(a: tuple[int, float], b: tuple[int, float]) -> float:
        line, apart = strings[a[0]], abs(a[1] - b[1])
        return min(apart, line.length_m - apart) if line.closed else apart

    right = along(over, real.over) + along(under, real.under)
    return over[0] == under[0] == real.over[0] and right > along(over, real.under) + along(under, real.over)
