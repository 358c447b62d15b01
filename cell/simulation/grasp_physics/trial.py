"""Simulate one grasp: approach, close, lift and hold."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from cell.simulation.grasp_physics.pieces import distance_along
from cell.simulation.grasp_physics.settings import NO_ERROR, PhysicsSettings, RobotError
from cell.simulation.grasp_physics.world import World, build_world, load_mujoco
from cell.simulation.scenes.scenes import StringScene
from recognition.geometry.polyline import arc_length
from recognition.grasping.gripper import Gripper

Touched = Literal["table", "object", "other strand", "gripped strand"]
"""What the gripper touches before it closes. A distant part of the gripped string is another strand."""
MIN_BETWEEN_M = 0.001
"""Minimum depth to which a strand reaches into the space between the fingers, to be there without touching them."""
INNER_FACE_M = 0.001
"""Distance behind the inner face of a finger up to which a contact is on the inner face."""
SEGMENT_SAMPLES = 5


@dataclass(frozen=True)
class Touch:
    """Contact of the gripper before it closes."""

    what: Touched
    """What is touched."""
    by: Literal["finger", "palm"]
    """Part of the gripper."""
    depth_m: float
    """Largest depth of the contact."""
    force_n: float
    """Largest force of one contact."""


@dataclass(frozen=True)
class GraspOutcome:
    """Result of one simulated grasp."""

    held: bool
    """Whether both fingers hold the right string after the lift, within a finger's width of the grasp along the string,
    and this part of the string has risen by more than half of the lift."""
    wrong_string: bool
    """Whether another string, or a distant part of the same string, is between the fingers after the lift."""
    touches: tuple[Touch, ...]
    """What the gripper touched before it closed."""
    rise_m: float
    """Mean rise of the segments between the fingers that are near the grasp along the string, 0 without one."""
    slip_m: float | None
    """Distance along the string from the grasp to the nearest segment that both fingers hold, None without one. It is
    accurate to half a segment."""

    @property
    def good(self) -> bool:
        """Whether the grasp lifts the right string and nothing else."""
        return self.held and not self.wrong_string

    def touches_more(self) -> bool:
        """Return whether the gripper touched anything but the gripped strand."""
        return any(touch.what != "gripped strand" for touch in self.touches)


@dataclass(frozen=True, eq=False)
class PlannedGrasp:
    """A grasp to carry out on a string of the true scene."""

    string: int
    """Index of the string that is to be gripped."""
    s_m: float
    """Arc length of the grasp along this string."""
    T_base_grasp: NDArray[np.float64]
    """(4, 4) pose of the grasp: z along the approach, x in the closing direction, origin on the centre line."""
    opening_m: float
    """Distance between the fingers before they close."""
    reach_m: float
    """Distance of the fingertips beyond the origin, along z."""


def simulate_grasp(
    scene: StringScene,
    grasp: PlannedGrasp,
    gripper: Gripper,
    error: RobotError = NO_ERROR,
    settings: PhysicsSettings | None = None,
) -> GraspOutcome:
    """Simulate a grasp: approach along z, close, lift back along z and hold. The same arguments give the same result.

    Args:
        scene: True scene.
        grasp: Grasp to carry out.
        gripper: Dimensions of the gripper.
        error: Error of the robot.
        settings: Material and numerical parameters. None: the defaults.
    """
    mujoco = load_mujoco()
    settings = settings or PhysicsSettings()
    T_base_grasp = error.apply(grasp.T_base_grasp)
    world = build_world(scene, T_base_grasp, grasp.opening_m, grasp.reach_m, gripper, settings)
    data = mujoco.MjData(world.model)
    start = -settings.raise_m * T_base_grasp[:3, 2]
    data.qpos[world.carriage_qpos] = start
    mujoco.mj_forward(world.model, data)
    strands = _Strands.of(scene, grasp, gripper, world, data)
    touches = _Touches(world, strands)

    def move(duration_s: float, to_m: NDArray[np.float64], close_m: float, watch: Callable | None = None) -> None:
        """Move the gripper and the set point of the fingers smoothly to their targets."""
        from_m, from_close_m = data.qpos[world.carriage_qpos].copy(), data.ctrl.copy()
        steps = round(duration_s / settings.time_step_s)
        for step in range(1, steps + 1):
            share = (step / steps) ** 2 * (3 - 2 * step / steps)
            target = from_m + share * (to_m - from_m)
            data.qvel[world.carriage_dof] = (target - data.qpos[world.carriage_qpos]) / settings.time_step_s
            data.ctrl[:] = from_close_m + share * (close_m - from_close_m)
            mujoco.mj_step(world.model, data)
            if watch is not None:
                watch(data)

    closed_m = grasp.opening_m / 2
    move(settings.descend_s, np.zeros(3), 0.0, touches.note)
    move(settings.close_s, np.zeros(3), closed_m)
    lifted = -settings.lift_m * T_base_grasp[:3, 2]
    move(settings.lift_s, lifted, closed_m)
    move(settings.hold_s, lifted, closed_m)

    touching = _touching_fingers(world, data, T_base_grasp[:3, 0], grasp.opening_m)
    near = strands.along_m <= gripper.finger_width_m
    gripped = near & touching.all(axis=1)
    between = touching.any(axis=1) | _between_fingers(world, data, T_base_grasp, grasp, gripper)
    rise_m = data.geom_xpos[world.segments, 2] - strands.height_m
    mean_rise_m = float(rise_m[near & between].mean()) if (near & between).any() else 0.0
    return GraspOutcome(
        held=bool(gripped.any()) and float(rise_m[gripped].mean()) > settings.lift_m / 2,
        wrong_string=bool((between & ~strands.gripped).any()),
        touches=touches.found(),
        rise_m=mean_rise_m,
        slip_m=float(strands.along_m[gripped].min()) if gripped.any() else None,
    )


def is_gripped_strand(
    along_m: NDArray[np.float64], points: NDArray[np.float64], grasp: PlannedGrasp, gripper: Gripper
) -> NDArray[np.bool_]:
    """Return which points (N, 3) of the gripped string belong to the gripped strand.

    A string bends little over a few centimetres. A part that is much farther away along the string (`along_m`, (N,),
    metres) than in space is another strand.
    """
    away = np.linalg.norm(points - grasp.T_base_grasp[:3, 3], axis=1)
    return along_m <= 2 * away + gripper.finger_width_m


def drift_at_rest(
    scene: StringScene,
    centre_m: NDArray[np.float64],
    settings: PhysicsSettings | None = None,
    duration_s: float = 0.5,
) -> NDArray[np.float64]:
    """Return how far the segments (S,) near `centre_m` (3,) move in `duration_s` without a gripper, metres."""
    mujoco = load_mujoco()
    settings = settings or PhysicsSettings()
    T_base_grasp = np.eye(4)
    T_base_grasp[:3, :3] = np.diag([1.0, -1.0, -1.0])
    T_base_grasp[:3, 3] = centre_m
    world = build_world(scene, T_base_grasp, 0.01, 0.0, Gripper(), settings)
    data = mujoco.MjData(world.model)
    far = np.array([0.0, 0.0, 1.0])
    data.qpos[world.carriage_qpos] = far
    mujoco.mj_forward(world.model, data)
    start = data.geom_xpos[world.segments].copy()
    for _ in range(round(duration_s / settings.time_step_s)):
        data.qvel[world.carriage_dof] = (far - data.qpos[world.carriage_qpos]) / settings.time_step_s
        mujoco.mj_step(world.model, data)
    return np.linalg.norm(data.geom_xpos[world.segments] - start, axis=1)


@dataclass(frozen=True, eq=False)
class _Strands:
    """Which of the S segments are at the grasp, before it begins."""

    along_m: NDArray[np.float64]
    """(S,) distance along the string from the grasp, infinite on other strings."""
    gripped: NDArray[np.bool_]
    """(S,) whether the segment belongs to the gripped strand."""
    height_m: NDArray[np.float64]
    """(S,) height of the middle of the segment."""

    @classmethod
    def of(cls, scene: StringScene, grasp: PlannedGrasp, gripper: Gripper, world: World, data: Any) -> "_Strands":
        length_m = float(arc_length(scene.curves[grasp.string])[-1])
        along = distance_along(world.s_m[world.segments], grasp.s_m, length_m, scene.closed[grasp.string])
        along = np.where(world.string[world.segments] == grasp.string, along, np.inf)
        middle = data.geom_xpos[world.segments]
        return cls(along, is_gripped_strand(along, middle, grasp, gripper), middle[:, 2].copy())


class _Touches:
    """Largest depth and force of each kind of contact of the gripper."""

    def __init__(self, world: World, strands: _Strands) -> None:
        self._world = world
        self._worst: dict[tuple[Touched, Literal["finger", "palm"]], tuple[float, float]] = {}
        self._gripper = np.zeros(world.model.ngeom, dtype=bool)
        self._gripper[[*world.fingers, world.palm]] = True
        self._what: list[Touched] = ["object"] * world.model.ngeom
        self._what[world.table] = "table"
        for geom, gripped in zip(world.segments, strands.gripped, strict=True):
            self._what[geom] = "gripped strand" if gripped else "other strand"

    def note(self, data: Any) -> None:
        """Note the contacts of this moment."""
        mujoco = load_mujoco()
        geoms = data.contact.geom
        pairs = self._gripper[geoms]
        for contact in np.flatnonzero((pairs[:, 0] != pairs[:, 1]) & (data.contact.dist < 0)):
            mine, other = geoms[contact] if pairs[contact, 0] else geoms[contact, ::-1]
            force = np.zeros(6)
            mujoco.mj_contactForce(self._world.model, data, int(contact), force)
            key = (self._what[other], "palm" if mine == self._world.palm else "finger")
            depth_m, force_n = self._worst.get(key, (0.0, 0.0))
            self._worst[key] = max(depth_m, -float(data.contact.dist[contact])), max(force_n, float(force[0]))

    def found(self) -> tuple[Touch, ...]:
        return tuple(Touch(what, by, depth, force) for (what, by), (depth, force) in sorted(self._worst.items()))


def _touching_fingers(world: World, data: Any, closing: NDArray[np.float64], opening_m: float) -> NDArray[np.bool_]:
    """Return which segments touch the inner face of the first and of the second finger, (S, 2)."""
    result = np.zeros((world.model.ngeom, 2), dtype=bool)
    hand = data.body("hand").xpos
    for side, (finger, qpos) in enumerate(zip(world.fingers, world.finger_qpos, strict=True)):
        inner = opening_m / 2 - data.qpos[qpos]
        hit = (data.contact.geom == finger).any(axis=1) & (data.contact.dist < 0)
        across = (data.contact.pos[hit] - hand) @ closing * (-1.0, 1.0)[side]
        # The position of a contact is in the middle of the overlap.
        result[data.contact.geom[hit][across < inner + INNER_FACE_M], side] = True
    return result[world.segments]


def _between_fingers(
    world: World, data: Any, T_base_grasp: NDArray[np.float64], grasp: PlannedGrasp, gripper: Gripper
) -> NDArray[np.bool_]:
    """Return which segments (S,) reach into the space between the fingers by more than `MIN_BETWEEN_M`."""
    centre = data.geom_xpos[world.segments]
    axis = data.geom_xmat[world.segments].reshape(-1, 3, 3)[:, :, 2]
    radius, half = world.model.geom_size[world.segments, :2].T
    along = np.linspace(-1.0, 1.0, SEGMENT_SAMPLES)[None, :, None] * half[:, None, None]
    local = (centre[:, None] + along * axis[:, None] - data.body("hand").xpos) @ T_base_grasp[:3, :3]
    gap = grasp.opening_m - float(data.qpos[world.finger_qpos].sum())
    low = np.array([-gap / 2, -gripper.finger_width_m / 2, grasp.reach_m - gripper.finger_depth_m])
    high = np.array([gap / 2, gripper.finger_width_m / 2, grasp.reach_m])
    outside = np.maximum(np.maximum(low - local, local - high), 0.0)
    return (np.linalg.norm(outside, axis=2) < radius[:, None] - MIN_BETWEEN_M).any(axis=1)
