"""Tightening of knots: strings as elastic rods that are pulled at their ends.

Each string is an elastic rod without friction and twist, with nodes half a radius apart. Horizontal forces pull its
ends outwards, while bending stiffness, contact, weight and the table resist. The knot is tightened until it is as
small as requested, and then comes to rest with its ends held. Lengths are in radii, forces in B / r^2 with the bending
stiffness B.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from cell.simulation.scenes.planar_crossings import plan_crossings
from cell.simulation.scenes.rod_contacts import contacts, strand_numbers
from cell.simulation.scenes.rod_relaxation import rod_stencil, rows_along, rows_of_axes
from cell.simulation.scenes.scenes import SceneError
from recognition.geometry.polyline import resample

NODE_STEP = 0.5
"""Distance of the nodes, radii."""
MAX_OVERLAP = 0.1
"""Largest overlap of two strands, radii. It is 5 % of the diameter, as in a string that is slightly soft."""
_PULL = 3.0
"""Force at each end."""
_WEIGHT = 0.02
"""Weight per radius of length. A free length of 10 radii then sags by about a radius."""
_STRETCH, _CONTACT = 2e3, 600.0
_DRAG, _HELD = 0.02, 1e4
_REACH = 0.4
"""Largest motion of a node in one step, radii. Strands do not pass through each other, because they are 2 thick."""
_MAX_STEPS, _MIN_REST_STEPS, _MAX_REST_STEPS = 900, 20, 60
_TAIL = 9.0
"""Length of tail beyond the core that is kept while tightening, radii."""

Curves = list[NDArray[np.float64]]


def tighten(curves: Sequence[NDArray[np.float64]], pulls: Sequence[NDArray[np.float64]], size: float) -> Curves:
    """Pull a knot tight until its core has a size.

    Args:
        curves: Centre lines (N, 3) of the loose knot, radii. Strands are at least 2 apart.
        pulls: Unit directions (2, 2) in which the first and the last point of each curve are pulled.
        size: Size of the core at which to stop, as `core_size` measures it, radii.

    Returns:
        The centre lines at rest, with nodes `NODE_STEP` apart, radii.

    Raises:
        SceneError: The knot does not become this small, or strands overlap by more than `MAX_OVERLAP`.
    """
    nodes = [resample(np.asarray(curve), NODE_STEP) for curve in curves]
    for step in range(_MAX_STEPS):
        nodes = _descend(nodes, pulls, NODE_STEP)
        if step % 4 == 0:
            core = core_range(nodes)
            if core is None:
                raise SceneError("the knot came undone")
            if _size(nodes, core) <= size:
                break
            nodes = _without_long_tails(nodes, core)
    else:
        raise SceneError(f"the knot cannot be tightened to {size:.1f} radii")
    overlap, step = MAX_OVERLAP, 0
    while step < _MIN_REST_STEPS or (overlap > MAX_OVERLAP / 2 and step < _MAX_REST_STEPS):
        nodes, step = _descend(nodes, None, NODE_STEP), step + 1
        overlap = float(contacts(np.vstack(nodes), strand_numbers(nodes), 1.0)[1].max(initial=0.0))
    if overlap > MAX_OVERLAP:
        raise SceneError(f"strands of the knot overlap by {overlap:.2f} radii")
    return nodes


def core_range(curves: Sequence[NDArray[np.float64]]) -> list[tuple[float, float]] | None:
    """Return the first and last position of a crossing on each curve, in units of its points, or None without any."""
    passes: list[list[float]] = [[] for _ in curves]
    for crossing in plan_crossings(curves):
        for string, position in (crossing.first, crossing.second):
            passes[string].append(position)
    return [(min(p), max(p)) for p in passes] if all(passes) else None


def core_size(curves: Sequence[NDArray[np.float64]]) -> float:
    """Return the largest horizontal distance in the core, the part of a knot between its outermost crossings."""
    core = core_range(curves)
    return 0.0 if core is None else _size(curves, core)


def _size(curves: Sequence[NDArray[np.float64]], core: list[tuple[float, float]]) -> float:
    points = np.vstack([curve[int(a) : int(b) + 2, :2] for curve, (a, b) in zip(curves, core, strict=True)])
    return float(np.linalg.norm(points[:, None] - points[None], axis=2).max())


def _without_long_tails(nodes: Curves, core: list[tuple[float, float]]) -> Curves:
    """Cut the tails that are pulled out of the knot, because they are straight and cost time."""
    keep = int(_TAIL / NODE_STEP)
    return [n[max(int(a) - keep, 0) : int(b) + keep + 2] for n, (a, b) in zip(nodes, core, strict=True)]


def _descend(nodes: Curves, pulls: Sequence[NDArray[np.float64]] | None, step: float) -> Curves:
    """Return the nodes after one damped Newton step of the energy. Without pulls, the ends are held."""
    from scipy.sparse import diags_array
    from scipy.sparse.linalg import spsolve

    x, string = np.vstack(nodes), strand_numbers(nodes)
    bends = rod_stencil(np.nonzero(string[2:] == string[:-2])[0], (1.0, -2.0, 1.0), len(x))
    along = rod_stencil(np.nonzero(string[1:] == string[:-1])[0], (-1.0, 1.0), len(x))
    bending = bends.T @ bends / step**3
    gradient = bending @ x
    gradient[:, 2] += _WEIGHT * step
    edge = along @ x
    length = np.linalg.norm(edge, axis=1)
    rows = rows_along(along, edge / length[:, None])
    touch, depth = contacts(x, string, 1.0)
    drag = np.full_like(x, _DRAG)
    for k in range(len(nodes)):
        inside = np.nonzero(string == k)[0]
        ends = inside[[0, -1]]
        if pulls is None:
            drag[ends] = _HELD
        else:
            gradient[ends, :2] -= _PULL * pulls[k]
    gradient += (rows.T @ (_STRETCH * (length - step)) - touch.T @ (_CONTACT * depth)).reshape(-1, 3)
    hessian = rows_of_axes(bending) + _STRETCH * rows.T @ rows + _CONTACT * touch.T @ touch + diags_array(drag.ravel())
    move = -np.asarray(spsolve(hessian.tocsc(), gradient.ravel())).reshape(-1, 3)
    x = x + move * min(1.0, _REACH / np.abs(move).max())
    return [x[string == k] for k in range(len(nodes))]
