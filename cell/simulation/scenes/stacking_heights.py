"""Heights of strings that cross each other on a table."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from cell.simulation.scenes.planar_crossings import Curves, PlanCrossing, is_closed
from cell.simulation.scenes.strand_clearance import step_of

BEND_RADII = (9.0, 7.0, 5.5, 4.5)
"""Bend radii of the ramps in radii, of which the first feasible one is taken. The first is that of a rope in a physics
engine, and the last is the tightest bend on the table."""
MAX_SLOPE = 0.7
"""Largest slope of a ramp."""


class HeightsError(ValueError):
    """The strings cannot lie over each other like that."""

    slug = "scene"


def lay(
    plan: Curves,
    crossings: Sequence[PlanCrossing],
    first_over: Sequence[bool],
    radii_m: Sequence[float],
    softness: float,
    support_m: Sequence[NDArray[np.float64]] | None = None,
) -> list[NDArray[np.float64]]:
    """Return the heights (N,) of the centre lines of strings with given courses on the table.

    The strings are as low as possible under three conditions, which is a linear programme in the heights. No point is
    lower than the radius, or than its support. Points of two strands have at least `softness` times the sum of their
    radii between them, the over strand above. Ramps bend no tighter than one of `BEND_RADII` and are no steeper than
    `MAX_SLOPE`. Elasticity beyond the bend limit, friction, and the bending of the under strand by the weight are not
    modelled.

    Args:
        plan: Courses (N, 2) in even steps.
        crossings: Crossings of the courses.
        first_over: Whether the first strand of each crossing is the upper one.
        radii_m: Radius of each string.
        softness: Height between centre lines in contact, relative to the sum of the radii.
        support_m: Smallest height (N,) of each point of each string, metres. None: the radius of the string.

    Raises:
        HeightsError: The conditions contradict each other.
    """
    from scipy.optimize import linprog
    from scipy.sparse import csr_array, vstack

    offsets = np.concatenate([[0], np.cumsum([len(curve) for curve in plan])])
    total = int(offsets[-1])
    # heights are in radii of the first string, because the tolerances of the solver are absolute
    unit_m = radii_m[0]
    contact_rows, gap = _contacts(plan, offsets, crossings, first_over, softness, radii_m)
    slope_rows, slope_steps, _ = _differences(plan, offsets, (-1.0, 1.0))
    bend_rows, bend_steps, bend_string = _differences(plan, offsets, (1.0, -2.0, 1.0))
    slope_limit = MAX_SLOPE * slope_steps / unit_m
    thickness = np.array([radius_m / unit_m for radius_m in radii_m])
    lowest = np.repeat(thickness, [len(curve) for curve in plan])
    if support_m is not None:
        lowest = np.maximum(lowest, np.concatenate(list(support_m)) / unit_m)
    A = csr_array(vstack([slope_rows, -slope_rows, bend_rows, -bend_rows, -contact_rows]))
    joints = _joints(plan, offsets)
    for bend in BEND_RADII:
        bend_limit = (bend_steps / unit_m) ** 2 / (bend * thickness[bend_string])
        b = np.concatenate([slope_limit, slope_limit, bend_limit, bend_limit, -gap])
        solution = linprog(
            np.ones(total),
            A_ub=A,
            b_ub=b,
            A_eq=joints,
            b_eq=None if joints is None else np.zeros(sum(map(is_closed, plan))),
            bounds=np.column_stack([lowest, np.full(total, np.inf)]),
            method="highs",
        )
        if solution.success:
            z = np.maximum(solution.x, lowest) * unit_m
            heights = [z[offsets[k] : offsets[k + 1]] for k in range(len(plan))]
            for height, curve in zip(heights, plan, strict=True):
                height[-1] = height[0] if is_closed(curve) else height[-1]
            return heights
    raise HeightsError("strands cross one another too close together to bend over and under each other")


def _differences(plan: Curves, offsets: NDArray[np.int64], stencil: tuple[float, ...]):
    """Return rows that apply `stencil` to neighbouring heights of every string, with string and step of each row.

    The rows of a closed string continue over its joint.
    """
    from scipy.sparse import csr_array

    width = len(stencil)
    string, columns = [], []
    for k, curve in enumerate(plan):
        closed = is_closed(curve)
        first = np.arange(len(curve) - 1 if closed else len(curve) - width + 1)
        around = len(curve) - 1 if closed else len(curve)
        columns.append(offsets[k] + (first[:, None] + np.arange(width)) % around)
        string.append(np.full(len(first), k))
    column, row_string = np.concatenate(columns), np.concatenate(string)
    row = np.arange(len(column))
    rows = csr_array(
        (np.repeat(stencil, len(row)), (np.tile(row, width), column.T.ravel())), shape=(len(row), int(offsets[-1]))
    )
    return rows, np.array([step_of(curve) for curve in plan])[row_string], row_string


def _joints(plan: Curves, offsets: NDArray[np.int64]):
    """Return rows "last minus first" of the closed strings, or None without closed strings."""
    from scipy.sparse import csr_array

    closed = [k for k, curve in enumerate(plan) if is_closed(curve)]
    if not closed:
        return None
    row = np.arange(len(closed))
    columns = np.concatenate([offsets[closed], offsets[np.array(closed) + 1] - 1])
    weights = np.repeat([-1.0, 1.0], len(closed))
    return csr_array((weights, (np.tile(row, 2), columns)), shape=(len(closed), int(offsets[-1])))


def _contacts(
    plan: Curves,
    offsets: NDArray[np.int64],
    crossings: Sequence[PlanCrossing],
    first_over: Sequence[bool],
    softness: float,
    radii_m: Sequence[float],
):
    """Return rows "over minus under" of all pairs of points that would touch on the table, and the gap that each needs.

    Every pair belongs to the crossing that is nearest along both strands.
    """
    from scipy.sparse import csr_array
    from scipy.spatial import KDTree

    total, unit_m = int(offsets[-1]), radii_m[0]
    rows: list[NDArray[np.int64]] = []
    columns: list[NDArray[np.int64]] = []
    weights: list[NDArray[np.float64]] = []
    gaps: list[NDArray[np.float64]] = []
    count = 0
    for crossing, first_is_over in zip(crossings, first_over, strict=True):
        thick_m = radii_m[crossing.first[0]] + radii_m[crossing.second[0]]
        apart_m = thick_m * softness
        sides = []
        for string, position in (crossing.first, crossing.second):
            curve = plan[string]
            step = step_of(curve)
            reach = int(np.ceil(1.5 * apart_m / np.sin(crossing.angle_rad) / step))
            low, high = max(int(position) - reach, 0), min(int(position) + reach + 2, len(curve))
            sides.append((np.arange(low, high), curve[low:high], offsets[string]))
        (index_a, points_a, offset_a), (index_b, points_b, offset_b) = sides
        near = KDTree(points_a).sparse_distance_matrix(KDTree(points_b), apart_m, output_type="ndarray")
        near = near[np.lexsort((near["j"], near["i"]))]
        a, b = index_a[near["i"]] + offset_a, index_b[near["j"]] + offset_b
        # neighbouring points of one strand are not a contact
        apart = (np.abs(a - b) > np.pi * (thick_m / 2) / step) if crossing.first[0] == crossing.second[0] else a >= 0
        a, b, distance = a[apart], b[apart], near["v"][apart]
        over, under = (a, b) if first_is_over else (b, a)
        row = count + np.arange(len(over))
        rows.append(np.concatenate([row, row]))
        columns.append(np.concatenate([over, under]))
        weights.append(np.concatenate([np.ones(len(over)), -np.ones(len(over))]))
        gaps.append(np.sqrt(np.maximum(apart_m**2 - distance**2, 0.0)) / unit_m)
        count += len(over)
        exact = []
        for (string, position), sign in zip(
            (crossing.first, crossing.second), (1.0, -1.0) if first_is_over else (-1.0, 1.0), strict=True
        ):
            k = min(int(position), len(plan[string]) - 2)
            share = position - k
            exact += [(offsets[string] + k, sign * (1 - share)), (offsets[string] + k + 1, sign * share)]
        rows.append(np.full(4, count))
        columns.append(np.array([column for column, _ in exact]))
        weights.append(np.array([weight for _, weight in exact]))
        gaps.append(np.array([apart_m / unit_m]))
        count += 1
    if not gaps:
        return csr_array((0, total)), np.zeros(0)
    matrix = csr_array((np.concatenate(weights), (np.concatenate(rows), np.concatenate(columns))), shape=(count, total))
    return matrix, np.concatenate(gaps)
