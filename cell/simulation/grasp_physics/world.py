"""Physics world of the surroundings of one grasp: table, obstacles, pieces of strings, and a gripper.

A string is a chain of capsules with ball joints that resist bending and twisting. Its shape in the scene is its rest
shape. A second, thinner capsule in each segment collides with other strands only, so that strands that are pressed
together in the scene stay where they lie.

The gripper moves on three slides with the mass of a robot. Its velocity is prescribed, so that friction carries the
string along, which it would not do with a body that jumps from pose to pose.
"""

from dataclasses import dataclass
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cell.simulation.grasp_physics.pieces import SAME_STRAND_RADII, Piece, core_share, cut_pieces
from cell.simulation.grasp_physics.settings import PhysicsSettings
from cell.simulation.rendering.meshes import clump_mesh
from cell.simulation.scenes.scenes import StringScene
from recognition.geometry.polyline import arc_length, unit_vectors
from recognition.grasping.gripper import Gripper

PALM_HEIGHT_M = 0.06
"""Height of the palm, along the approach."""
CARRIAGE_KG = 1e4
"""Inertia of the robot behind the gripper. Contact does not move it."""
FINGER_KG = 0.1
"""Mass of a finger."""
PALM_REACH_M = 0.062
"""Distance from the grasp, in the table plane, that the palm of the default gripper does not exceed. Pieces of strings
that are farther away do not move."""
CONTACT_S = 0.004
"""Time constant of contacts. They give by some tenths of a millimetre under full grip, like the jacket of a cable."""
CUT_SOFTNESS_S = 0.05
"""Time constant of the spring that holds the end of an arch where it is cut. During a lift, it pulls with less than
1 N."""
TABLE, OBJECT, STRING, BELLY, CORE, GRIPPER = (1 << bit for bit in range(6))
"""Kinds of geoms, as bits of their contact masks. A belly is a sphere in the middle of a segment."""
COLLIDES = {
    TABLE: BELLY | GRIPPER,
    OBJECT: STRING | GRIPPER,
    STRING: OBJECT | GRIPPER,
    BELLY: TABLE,
    CORE: CORE,
    GRIPPER: TABLE | OBJECT | STRING,
}


@dataclass(frozen=True, eq=False)
class World:
    """Compiled model of the surroundings of a grasp. All geoms are in the base frame, metres."""

    model: Any
    """`mujoco.MjModel`. The gripper is at the grasp pose, open."""
    string: NDArray[np.int64]
    """(G,) index of the string of each geom, -1 for a geom that is no string."""
    s_m: NDArray[np.float64]
    """(G,) arc length of the middle of each segment along its string, NaN for a geom that is no string."""
    segments: NDArray[np.int64]
    """(S,) geoms of the segments, without their cores."""
    table: int
    """Geom of the table."""
    fingers: tuple[int, int]
    """Geoms of the fingers, at negative and at positive x of the grasp frame."""
    palm: int
    """Geom of the palm."""
    carriage_qpos: NDArray[np.int64]
    """(3,) addresses of the displacement of the gripper from the grasp pose, in the base frame."""
    carriage_dof: NDArray[np.int64]
    """(3,) addresses of its velocity."""
    finger_qpos: NDArray[np.int64]
    """(2,) addresses of the displacements of the fingers from their open positions, towards each other."""


def load_mujoco() -> Any:
    """Import MuJoCo. It is compiled and has no types, and only development installs it."""
    return import_module("mujoco")


def build_world(
    scene: StringScene,
    T_base_grasp: NDArray[np.float64],
    opening_m: float,
    reach_m: float,
    gripper: Gripper,
    settings: PhysicsSettings,
) -> World:
    """Return the world of the surroundings of a grasp.

    Args:
        scene: True scene.
        T_base_grasp: (4, 4) pose that the gripper reaches.
        opening_m: Distance between the open fingers.
        reach_m: Distance of the fingertips beyond the origin of the grasp.
        gripper: Dimensions of the gripper.
        settings: Material and numerical parameters.
    """
    mujoco = load_mujoco()
    spec = mujoco.MjSpec()
    spec.option.timestep = settings.time_step_s
    # Stiffness, damping and contact are implicit in this integrator, so that thin, stiff strings are stable.
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_DISCRETE
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    spec.option.impratio = 10.0
    _add_static(spec, scene, settings)
    pieces = cut_pieces(scene, T_base_grasp[:3, 3], settings)
    lengths_m = [float(arc_length(curve)[-1]) for curve in scene.curves]
    core = core_share(pieces, scene.closed, lengths_m)
    for number, piece in enumerate(pieces):
        _add_piece(spec, piece, f"{number}", core, T_base_grasp[:3, 3], settings)
    _add_gripper(spec, T_base_grasp, opening_m, reach_m, gripper, settings)
    model = spec.compile()

    string, s_m = np.full(model.ngeom, -1), np.full(model.ngeom, np.nan)
    segments = []
    for number, piece in enumerate(pieces):
        for k, s in enumerate(piece.s_m):
            outer, inner = (model.geom(f"{kind} {number} {k}").id for kind in ("segment", "core"))
            string[[outer, inner]], s_m[[outer, inner]] = piece.string, s
            segments.append(outer)
    joints = [model.joint(name) for name in ("carriage x", "carriage y", "carriage z")]
    return World(
        model,
        string,
        s_m,
        np.array(segments, dtype=np.int64),
        table=model.geom("table").id,
        fingers=(model.geom("finger 0").id, model.geom("finger 1").id),
        palm=model.geom("palm").id,
        carriage_qpos=np.array([joint.qposadr[0] for joint in joints]),
        carriage_dof=np.array([joint.dofadr[0] for joint in joints]),
        finger_qpos=np.array([model.joint(f"finger {k}").qposadr[0] for k in (0, 1)]),
    )


def _contact(kind: int, friction: float) -> dict[str, Any]:
    """Return the attributes of a geom for contact."""
    return {
        "contype": kind,
        "conaffinity": COLLIDES[kind],
        "friction": [friction, 0.005, 0.0001],
        "solref": [CONTACT_S, 1.0],
        "solimp": [0.95, 0.999, 0.0005, 0.5, 2.0],
    }


def _add_static(spec: Any, scene: StringScene, settings: PhysicsSettings) -> None:
    """Add the table, the boxes, the convex hulls of the clumps, and the rods. Cloths are soft and are not added."""
    mujoco = load_mujoco()
    contact = _contact(TABLE, settings.string_friction)
    spec.worldbody.add_geom(name="table", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[1, 1, 0.1], **contact)
    contact = _contact(OBJECT, settings.string_friction)
    for box in scene.boxes:
        width, depth, height = box.size_m
        spec.worldbody.add_geom(
            type=mujoco.mjtGeom.mjGEOM_BOX,
            size=[width / 2, depth / 2, height / 2],
            pos=[*box.centre_m, height / 2],
            quat=[np.cos(box.yaw_rad / 2), 0.0, 0.0, np.sin(box.yaw_rad / 2)],
            **contact,
        )
    for number, clump in enumerate(scene.clumps):
        vertices, _ = clump_mesh(clump)
        spec.add_mesh(name=f"clump {number}", uservert=vertices.ravel())
        spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname=f"clump {number}", **contact)
    for rod in scene.rods:
        spec.worldbody.add_geom(
            type=mujoco.mjtGeom.mjGEOM_CYLINDER,
            size=[rod.radius_m, 0.0, 0.0],
            fromto=[*rod.start_m, *rod.end_m],
            **contact,
        )


def _add_piece(
    spec: Any,
    piece: Piece,
    name: str,
    core: float,
    centre_m: NDArray[np.float64],
    settings: PhysicsSettings,
) -> None:
    """Add a piece of a string as two chains of bodies that begin at the segment nearest to the grasp.

    Two chains of half the length are simulated several times as fast as one of the whole length.
    """
    mujoco = load_mujoco()
    points, lengths, r, count = piece.points, piece.lengths_m, piece.radius_m, len(piece.s_m)
    R = _frames_along(unit_vectors(np.diff(points, axis=0)))
    weightless = piece.carried.astype(float)
    moves = bool((np.linalg.norm(points[:, :2] - centre_m[:2], axis=1) < PALM_REACH_M).any())
    root = int(np.linalg.norm((points[1:] + points[:-1]) / 2 - centre_m, axis=1).argmin())
    stiffness = settings.young_pa * np.pi * r**4 / 4 / float(lengths.mean())
    joint = {"stiffness": [stiffness, 0, 0], "damping": [settings.damping_s * stiffness, 0, 0]}

    def fill(body: Any, k: int, from_m: float, to_m: float) -> Any:
        for kind, mask, radius, mass in (
            ("segment", STRING, r, settings.density_kg_m3 * np.pi * r**2 * float(lengths[k])),
            ("core", CORE, core * r, 0.0),
        ):
            body.add_geom(
                name=f"{kind} {name} {k}",
                type=mujoco.mjtGeom.mjGEOM_CAPSULE,
                size=[radius, 0, 0],
                fromto=[from_m, 0, 0, to_m, 0, 0],
                mass=mass,
                **_contact(mask, settings.string_friction),
            )
        body.add_geom(
            type=mujoco.mjtGeom.mjGEOM_SPHERE,
            size=[r, 0, 0],
            pos=[(from_m + to_m) / 2, 0, 0],
            mass=0.0,
            **_contact(BELLY, settings.string_friction),
        )
        return body

    def child(parent: Any, of: int, k: int, x_m: float) -> Any:
        body = parent.add_body(
            name=f"{name} {k}",
            pos=[x_m, 0, 0],
            quat=_quaternion(R[of].T @ R[k]),
            gravcomp=weightless[k],
        )
        if moves:
            body.add_joint(type=mujoco.mjtJoint.mjJNT_BALL, **joint)
        return body

    first = spec.worldbody.add_body(name=f"{name} {root}", pos=points[root], quat=_quaternion(R[root]))
    first.gravcomp = weightless[root]
    if moves:
        first.add_freejoint()
    parent = fill(first, root, 0.0, lengths[root])
    for k in range(root + 1, count):
        parent = fill(child(parent, k - 1, k, lengths[k - 1]), k, 0.0, lengths[k])
    parent = first
    for k in range(root - 1, -1, -1):
        # The frame of a segment before the root is at its end.
        parent = fill(child(parent, k + 1, k, 0.0 if k + 1 == root else -lengths[k + 1]), k, -lengths[k], 0.0)
    if moves:
        for end, x_m in ((0, 0.0 if root == 0 else -lengths[0]), (count - 1, lengths[-1])):
            if piece.carried[end]:
                _connect(spec, f"{name} {end}", "world", x_m, CUT_SOFTNESS_S)
    # Segments of one strand do not collide.
    skip = int(np.ceil(SAME_STRAND_RADII * r / lengths.min())) + 1
    for k in range(count):
        for other in range(k + 2, k + skip + 1):
            if other < count or piece.ring:
                spec.add_exclude(bodyname1=f"{name} {k}", bodyname2=f"{name} {other % count}")
    if piece.ring and moves:
        spec.add_exclude(bodyname1=f"{name} 0", bodyname2=f"{name} {count - 1}")
        _connect(spec, f"{name} 0", f"{name} {count - 1}", 0.0 if root == 0 else -lengths[0], CONTACT_S)


def _connect(spec: Any, body: str, other: str, x_m: float, softness_s: float) -> None:
    """Connect the point at `x_m` along a segment to another body."""
    mujoco = load_mujoco()
    connected = spec.add_equality(
        type=mujoco.mjtEq.mjEQ_CONNECT,
        objtype=mujoco.mjtObj.mjOBJ_BODY,
        name1=body,
        name2=other,
        solref=[softness_s, 1.0],
    )
    connected.data = [x_m, 0.0, 0.0] + [0.0] * (len(connected.data) - 3)


def _add_gripper(
    spec: Any,
    T_base_grasp: NDArray[np.float64],
    opening_m: float,
    reach_m: float,
    gripper: Gripper,
    settings: PhysicsSettings,
) -> None:
    """Add the palm and two fingers that move together, with a limited force."""
    mujoco = load_mujoco()
    contact = _contact(GRIPPER, settings.finger_friction) | {"condim": 4, "mass": 0.0}
    inertia: dict[str, Any] = {"gravcomp": 1.0, "explicitinertial": True}
    carriage = spec.worldbody.add_body(name="carriage", mass=1.0, inertia=[1.0, 1.0, 1.0], **inertia)
    for name, axis in zip("xyz", np.eye(3), strict=True):
        carriage.add_joint(name=f"carriage {name}", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=axis, armature=CARRIAGE_KG)
    hand = carriage.add_body(
        name="hand",
        pos=T_base_grasp[:3, 3],
        quat=_quaternion(T_base_grasp[:3, :3]),
        mass=1.0,
        inertia=[1.0, 1.0, 1.0],
        **inertia,
    )
    box = mujoco.mjtGeom.mjGEOM_BOX
    half = [gripper.stroke_m / 2 + gripper.finger_thickness_m, gripper.palm_width_m / 2, PALM_HEIGHT_M / 2]
    hand.add_geom(
        name="palm", type=box, size=half, pos=[0, 0, reach_m - gripper.finger_depth_m - PALM_HEIGHT_M / 2], **contact
    )
    half = [gripper.finger_thickness_m / 2, gripper.finger_width_m / 2, gripper.finger_depth_m / 2]
    for k, side in enumerate((-1.0, 1.0)):
        middle = [side * (opening_m + gripper.finger_thickness_m) / 2, 0, reach_m - gripper.finger_depth_m / 2]
        finger = hand.add_body(name=f"finger {k}", pos=middle, mass=FINGER_KG, inertia=[1e-4] * 3, **inertia)
        finger.add_joint(name=f"finger {k}", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=[-side, 0, 0], damping=[20.0, 0, 0])
        finger.add_geom(name=f"finger {k}", type=box, size=half, **contact)
        actuator = spec.add_actuator(trntype=mujoco.mjtTrn.mjTRN_JOINT, target=f"finger {k}")
        actuator.set_to_position(kp=2e4, kv=100.0)
        actuator.forcelimited = True
        actuator.forcerange = [-settings.grip_force_n, settings.grip_force_n]
    together = spec.add_equality(
        type=mujoco.mjtEq.mjEQ_JOINT,
        objtype=mujoco.mjtObj.mjOBJ_JOINT,
        name1="finger 0",
        name2="finger 1",
        solref=[CONTACT_S, 1.0],
        solimp=[0.99, 0.9999, 0.0005, 0.5, 2.0],
    )
    together.data = [0.0, 1.0] + [0.0] * (len(together.data) - 2)


def _frames_along(direction: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return rotation matrices (N, 3, 3) whose x axes are the unit vectors `direction` (N, 3)."""
    up = np.where(np.abs(direction[:, 2:]) < 0.9, (0.0, 0.0, 1.0), (1.0, 0.0, 0.0))
    y = unit_vectors(np.cross(up, direction))
    return np.stack([direction, y, np.cross(direction, y)], axis=2)


def _quaternion(R: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the unit quaternion (4,) of a rotation matrix (3, 3), scalar first."""
    from scipy.spatial.transform import Rotation

    return Rotation.from_matrix(R).as_quat(scalar_first=True)
