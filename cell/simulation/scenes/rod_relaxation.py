"""Relaxation of strings under weight, bending stiffness and contact, in height and in the plane.

Each string is an elastic rod with nodes 3 mm apart. The result is the end of a slow, heavily damped descent of the
energy of weight, stretching, bending away from the permanent shape, and contact with the table and with other strands.
Under strands stay on the table. Over strands bend over them with long ramps and hang between table and contact. Strands
that are pushed aside touch each other.

Twist and true friction are not modelled. Strands creep slowly in the plane instead, and are stopped before they have
sprung as far as they could.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from cell.simulation.scenes.rod_contacts import contacts, strand_numbers
from cell.simulation.scenes.shapes import STEP_M
from recognition.geometry.polyline import resample

_STEP_M = 0.003
_STEPS = 120
_STRETCH = 2e3
"""Stiffness against stretching, in units of the string's weight per radius of length. The string is nearly
inextensible."""
_CONTACT = 4e3
"""Force per radius of penetration, in units of the string's weight per radius of length. Contacts give by some
thousandths of a radius."""
_DRAG_PLAN, _DRAG_UP = 20.0, 0.3
_REACH = 0.25
"""Largest motion of a node in one step, in radii."""

Curves = Sequence[NDArray[np.float64]]


def settle(
    curves: Curves, radius_m: float, softness: float, hang_radii: float, set_share: float
) -> list[NDArray[np.float64]]:
    """Return the centre lines at rest, in steps of at most 1 mm.

    Args:
        curves: Centre lines (N, 3) at the start, none inside another.
        radius_m: Radius of every string.
        softness: Height between centre lines in contact, relative to 2 r.
        hang_radii: Distance from a crossing at which a strand that is lifted by 2 r reaches the table, in radii. It
            gives the ratio of bending stiffness B to weight w, by h = w L^4 / (72 B) of an elastic beam lifted at its
            middle.
        set_share: Share of the curvature in the plane that each string has taken on permanently. At 1 nothing springs
            open.
    """
    from scipy.sparse import diags_array
    from scipy.sparse.linalg import spsolve

    nodes = [resample(np.asarray(curve), _STEP_M) / radius_m for curve in curves]
    string = strand_numbers(nodes)
    x = np.vstack(nodes)
    step = np.repeat([float(np.linalg.norm(np.diff(n, axis=0), axis=1).mean()) for n in nodes], [len(n) for n in nodes])
    before = np.nonzero(string[2:] == string[:-2])[0]
    bends = rod_stencil(before, (1.0, -2.0, 1.0), len(x))
    along = rod_stencil(np.nonzero(string[1:] == string[:-1])[0], (-1.0, 1.0), len(x))
    stiffness = hang_radii**4 / (72 * 2.0)
    bend_weight = stiffness / step[before] ** 3
    rest_turn = set_share * _turns(x, bends, before)
    bending = bends.T @ diags_array(bend_weight) @ bends
    segment_length = np.linalg.norm(along @ x, axis=1)
    drag = np.tile([_DRAG_PLAN, _DRAG_PLAN, _DRAG_UP], len(x))
    for _ in range(_STEPS):
        gradient = np.zeros_like(x)
        gradient[:, 2] = step
        gradient += bends.T @ (bend_weight[:, None] * (bends @ x - rest_turn[:, None] * _across(x, before)))
        hessian = rows_of_axes(bending)
        edge = along @ x
        long = np.linalg.norm(edge, axis=1)
        direction = edge / long[:, None]
        rows = rows_along(along, direction)
        gradient += (rows.T @ (_STRETCH * (long - segment_length))).reshape(-1, 3)
        hessian = hessian + _STRETCH * rows.T @ rows
        touch, depth = contacts(x, string, softness)
        gradient -= (touch.T @ (_CONTACT * depth)).reshape(-1, 3)
        hessian = hessian + _CONTACT * touch.T @ touch + diags_array(drag)
        move = -np.asarray(spsolve(hessian.tocsc(), gradient.ravel())).reshape(-1, 3)
        x = x + move * min(1.0, _REACH / np.abs(move).max())
    return [_fine(x[string == k] * radius_m, radius_m) for k in range(len(curves))]


def _fine(nodes: NDArray[np.float64], radius_m: float) -> NDArray[np.float64]:
    """Return a smooth curve (N, 3) through the nodes, lifted by the penetration of the table."""
    from scipy.interpolate import CubicSpline

    t = np.arange(len(nodes))
    curve = resample(CubicSpline(t, nodes)(np.linspace(0, t[-1], 20 * len(nodes))), STEP_M)
    curve[:, 2] = np.maximum(curve[:, 2], radius_m)
    return curve


def _turns(x: NDArray[np.float64], bends, before: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return the signed second difference in the plane, across the string, at each inner node."""
    return np.einsum("ij,ij->i", bends @ x, _across(x, before))


def _across(x: NDArray[np.float64], before: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return horizontal unit vectors (M, 3) to the left of the string at each inner node."""
    chord = x[before + 2] - x[before]
    left = np.column_stack([-chord[:, 1], chord[:, 0], np.zeros(len(chord))])
    return left / np.linalg.norm(left, axis=1, keepdims=True)


def rod_stencil(first: NDArray[np.int64], weights: tuple[float, ...], count: int):
    """Return rows (len(first), count) with `weights` from each of the nodes `first` on."""
    from scipy.sparse import csr_array

    width = len(weights)
    columns = (first[:, None] + np.arange(width)).ravel()
    return csr_array(
        (np.tile(weights, len(first)), columns, np.arange(0, width * len(first) + 1, width)), shape=(len(first), count)
    )


def rows_of_axes(matrix):
    """Return `matrix` (N, N) of nodes as a matrix (3 N, 3 N) for x, y and z of each node."""
    from scipy.sparse import eye_array, kron

    return kron(matrix, eye_array(3), format="csr")


def rows_along(rows, direction: NDArray[np.float64]):
    """Return rows (M, N) over nodes as rows (M, 3 N) over their coordinates, each along its direction (M, 3)."""
    from scipy.sparse import csr_array

    width = np.diff(rows.indptr)
    row = np.repeat(np.arange(rows.shape[0]), width)
    data = (rows.data[:, None] * direction[row]).ravel()
    columns = (3 * rows.indices[:, None] + np.arange(3)).ravel()
    return csr_array((data, (np.repeat(row, 3), columns)), shape=(rows.shape[0], 3 * rows.shape[1]))
