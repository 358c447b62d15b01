"""Fall of strings onto the table, by the physics of MuJoCo: weight, bending stiffness, contact and friction.

Each string is a chain of capsules with elastic ball joints, whose rest angles are those of the start. MuJoCo's time
for a chain grows with the square of its length, so a string is cut into chains that are welded together.

Contacts of MuJoCo are soft, and a chain of capsules has corners. Both are removed at the end: smooth curves through
the chains move apart until they overlap by at most `MAX_OVERLAP`.
"""

from collections.abc import Sequence
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cell.simulation.scenes.rod_contacts import contacts, strand_numbers
from cell.simulation.scenes.rod_relaxation import rod_stencil, rows_along, rows_of_axes
from cell.simulation.scenes.scenes import SceneError
from cell.simulation.scenes.shapes import STEP_M
from recognition.geometry.polyline import arc_length, resample, unit_vectors

MAX_OVERLAP = 0.1
"""Largest overlap of two strands, radii. It is 5 % of the diameter, as in a string that is slightly soft."""
_SEGMENT_RADII = 3.0
"""Length of a capsule, radii."""
_CHAIN_SEGMENTS = 12
"""Number of capsules of a chain."""
_DENSITY_KG_M3 = 1200.0
_FRICTION = 0.4
_TIME_STEP_S = 0.003
_FALL_S, _MAX_S = 0.3, 1.2
"""Shortest and longest simulated time."""
_REST_M_S = 0.02
"""Speed below which a string is at rest, root mean square over its capsules."""
_CONTACT_S = 0.006
"""Time constant of contacts and welds. MuJoCo needs at least two time steps."""
_GYRATION = 3.0
"""Radius of gyration of a capsule about all axes, in its lengths. It is larger than that of a real one, because soft
welds give by the acceleration that they prevent, and would kink. The inertia does not matter at rest."""
_HARD = [0.99, 0.9999, 0.0005, 0.5, 2.0]
"""Impedance of contacts and welds."""
_DAMPING_S = 0.05
"""Damping of the joints, relative to their stiffness."""
_AIR_1_S = 10.0
"""Rate at which a falling string loses speed. It falls at 1 m/s at most, so that strands do not pass each other."""
_SAME_STRAND_SEGMENTS = 3
"""Capsules of one string that are this near along it do not collide."""
_NODE_STEP = 0.75
"""Distance of the nodes that move apart at the end, radii."""
_MOVES = 30
"""Largest number of moves."""
_REACH = 0.3
"""Largest distance of one move, radii."""

Points = NDArray[np.float64]


class PhysicsError(ImportError):
    """MuJoCo is not installed."""

    slug = "scene"


def drop(curves: Sequence[Points], radius_m: float, hang_radii: float) -> list[Points]:
    """Let strings fall onto the table z = 0, and return them at rest.

    Args:
        curves: Centre lines (N, 3) above the table, metres. Strands are apart, and their bends are the rest shape.
        radius_m: Radius of the strings.
        hang_radii: Bending stiffness B, as the distance L from a crossing at which a strand that is lifted by 2 r
            reaches the table, in radii: B = w L^4 / (144 r) for the weight w per length.

    Returns:
        Centre lines (N, 3) in even steps of at most 1 mm.

    Raises:
        PhysicsError: MuJoCo is not installed.
        SceneError: The strings do not settle, or overlap.
    """
    chains = [resample(np.asarray(curve), _SEGMENT_RADII * radius_m) for curve in curves]
    fallen = _fall(chains, radius_m, hang_radii)
    nodes = _apart([resample(_smooth(points), _NODE_STEP * radius_m) / radius_m for points in fallen])
    curves = []
    for points in nodes:
        curve = resample(_smooth(points * radius_m, round_corners=False), STEP_M)
        curve[:, 2] = np.maximum(curve[:, 2], radius_m)
        curves.append(curve)
    return curves


def _fall(chains: Sequence[Points], radius_m: float, hang_radii: float) -> list[Points]:
    """Return the joints (N, 3) of the strings at rest."""
    mujoco = _load_mujoco()
    spec = mujoco.MjSpec()
    spec.option.timestep = _TIME_STEP_S
    # Stiffness, damping and contact are implicit in this integrator, so that thin, stiff strings are stable.
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_DISCRETE
    spec.option.jacobian = mujoco.mjtJacobian.mjJAC_SPARSE
    spec.option.iterations, spec.option.tolerance = 6, 1e-4
    contact: dict[str, Any] = {"friction": [_FRICTION, 0.005, 0.0001], "solref": [_CONTACT_S, 1.0], "solimp": _HARD}
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[1, 1, 0.1], contype=1, conaffinity=2, **contact)
    for number, joints in enumerate(chains):
        _add_string(spec, f"{number}", joints, radius_m, hang_radii, contact)
    model = spec.compile()
    data = mujoco.MjData(model)
    for step in range(int(_MAX_S / _TIME_STEP_S)):
        mujoco.mj_step(model, data)
        if not np.isfinite(data.qvel).all() or data.time < step * _TIME_STEP_S:
            raise SceneError("the physics of the falling strings became unstable")
        if data.time > _FALL_S and step % 10 == 0:
            speed = np.linalg.norm(data.cvel[1:, 3:], axis=1)
            if np.sqrt(np.mean(speed**2)) < _REST_M_S:
                break
    mujoco.mj_forward(model, data)
    fallen, first = [], 1
    for joints in chains:
        last = first + len(joints) - 2
        end = data.xpos[last] + data.xmat[last].reshape(3, 3)[:, 0] * np.linalg.norm(joints[-1] - joints[-2])
        fallen.append(np.vstack([data.xpos[first : last + 1], end]))
        first = last + 1
    return fallen


def _add_string(
    spec: Any, name: str, joints: Points, radius_m: float, hang_radii: float, contact: dict[str, Any]
) -> None:
    """Add a string as chains of capsules between its joints (N, 3)."""
    from scipy.spatial.transform import Rotation

    mujoco = _load_mujoco()
    edge = np.diff(joints, axis=0)
    length = np.linalg.norm(edge, axis=1)
    x = unit_vectors(edge)
    y = unit_vectors(np.cross((0.0, 0.0, 1.0), x))
    R = Rotation.from_matrix(np.stack([x, y, np.cross(x, y)], axis=2))
    turn = (R[:-1].inv() * R[1:]).as_quat(scalar_first=True)
    mass = _DENSITY_KG_M3 * np.pi * radius_m**2 * length
    weight_n_m = 9.81 * float(mass[0] / length[0])
    stiffness = weight_n_m * (hang_radii * radius_m) ** 4 / (144 * radius_m) / float(length.mean())
    joint = {"stiffness": [stiffness, 0, 0], "damping": [_DAMPING_S * stiffness, 0, 0]}
    body = spec.worldbody
    for k in range(len(edge)):
        if k % _CHAIN_SEGMENTS == 0:
            body = spec.worldbody.add_body(name=f"{name} {k}", pos=joints[k], quat=R[k].as_quat(scalar_first=True))
            drag = _AIR_1_S * float(mass[k : k + _CHAIN_SEGMENTS].sum())
            body.add_joint(type=mujoco.mjtJoint.mjJNT_FREE, damping=[drag, 0, 0])
            if k:
                spec.add_equality(
                    type=mujoco.mjtEq.mjEQ_WELD,
                    objtype=mujoco.mjtObj.mjOBJ_BODY,
                    name1=f"{name} {k - 1}",
                    name2=f"{name} {k}",
                    solref=[_CONTACT_S, 1.0],
                    solimp=_HARD,
                )
        else:
            body = body.add_body(name=f"{name} {k}", pos=[length[k - 1], 0, 0], quat=turn[k - 1])
            body.add_joint(type=mujoco.mjtJoint.mjJNT_BALL, **joint)
        inertia = mass[k] * (_GYRATION * length[k]) ** 2
        body.mass, body.ipos, body.inertia, body.explicitinertial = mass[k], [length[k] / 2, 0, 0], [inertia] * 3, True
        body.add_geom(
            type=mujoco.mjtGeom.mjGEOM_CAPSULE,
            size=[radius_m, 0, 0],
            fromto=[0, 0, 0, length[k], 0, 0],
            contype=2,
            conaffinity=3,
            **contact,
        )
        for other in range(max(k - _SAME_STRAND_SEGMENTS, 0), k):
            spec.add_exclude(bodyname1=f"{name} {other}", bodyname2=f"{name} {k}")


def _load_mujoco() -> Any:
    """Import MuJoCo. Only development installs it."""
    try:
        return import_module("mujoco")
    except ImportError as error:
        raise PhysicsError(
            "heaps of strings need MuJoCo, which is not installed; install the extra `dev`, or choose another tier"
        ) from error


def _smooth(points: Points, round_corners: bool = True) -> Points:
    """Return a fine smooth curve through points (N, 3), or, with `round_corners`, along the polyline on average.

    A curve through the corners of a polyline with edges h lies outside the edges by two thirds of the sagitta h^2 / 8 R
    on average. The corners are moved inwards by as much: by a twelfth of their second difference.
    """
    from scipy.interpolate import CubicSpline

    knots = points.copy()
    if round_corners:
        knots[1:-1] += (points[2:] - 2 * points[1:-1] + points[:-2]) / 12
    s = arc_length(knots)
    return CubicSpline(s, knots)(np.linspace(0.0, s[-1], 12 * len(s)))


def _apart(nodes: list[Points]) -> list[Points]:
    """Move strands apart where they overlap, and up where they are in the table. Lengths are in radii.

    The moves keep the length of the strings and vary smoothly along them.
    """
    from scipy.sparse import diags_array
    from scipy.sparse.linalg import spsolve

    string, start = strand_numbers(nodes), np.vstack(nodes)
    x = start.copy()
    step = np.concatenate([np.linalg.norm(np.diff(n, axis=0), axis=1) for n in nodes])
    bends = rod_stencil(np.nonzero(string[2:] == string[:-2])[0], (1.0, -2.0, 1.0), len(x))
    along = rod_stencil(np.nonzero(string[1:] == string[:-1])[0], (-1.0, 1.0), len(x))
    smooth = rows_of_axes(bends.T @ bends / _NODE_STEP**3 + diags_array(np.full(len(x), 1e-3)))
    for _ in range(_MOVES):
        touch, depth = contacts(x, string, 1.0)
        if depth.max(initial=0.0) < MAX_OVERLAP / 2:
            break
        edge = along @ x
        length = np.linalg.norm(edge, axis=1)
        rows = rows_along(along, edge / length[:, None])
        gradient = smooth @ (x - start).ravel() + rows.T @ (100.0 * (length - step)) - touch.T @ (600.0 * depth)
        hessian = smooth + 100.0 * rows.T @ rows + 600.0 * touch.T @ touch + diags_array(np.full(x.size, 0.02))
        move = -np.asarray(spsolve(hessian.tocsc(), gradient)).reshape(-1, 3)
        x = x + move * min(1.0, _REACH / np.abs(move).max())
    overlap = float(contacts(x, string, 1.0)[1].max(initial=0.0))
    if overlap > MAX_OVERLAP:
        raise SceneError(f"strands of the heap overlap by {overlap:.2f} radii")
    return [x[string == k] for k in range(len(nodes))]
