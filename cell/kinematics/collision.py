"""Distances of arm, camera and gripper from each other, the table and obstacles, for many postures at once.

The parts of the arm are capsules, which are a little thicker than the arm. A capsule contains all points within a
radius of a line segment. Above the table, the gripper counts with its boxes themselves, since its fingertips go down to
the table.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cell.config.arm_models import BASE_RADIUS_M, ArmModelName
from cell.config.cell_config import CellSettings
from cell.kinematics.capsule_distance import box_distances, segment_distances
from cell.kinematics.ur_kinematics import ARMS, link_frames
from recognition.grasping.gripper import Gripper


@dataclass(frozen=True)
class _Build:
    """Outer dimensions of an arm."""

    upper_arm_beside_m: float
    """Offset of the upper arm from the base's axis, along the shoulder's axis."""
    forearm_beside_m: float
    """Offset of the forearm from the base's axis, along the shoulder's axis."""
    upper_arm_m: float
    """Radius of the upper arm. Base and shoulder have the radius of the base."""
    elbow_m: float
    """Radius of the elbow."""
    forearm_m: float
    """Radius of the forearm."""
    wrist_m: float
    """Radius of the wrist."""


_BUILDS: dict[ArmModelName, _Build] = {
    "ur3e": _Build(0.120, 0.027, 0.050, 0.055, 0.042, 0.042),
    "ur5e": _Build(0.138, 0.007, 0.060, 0.062, 0.050, 0.047),
    "ur10e": _Build(0.176, 0.039, 0.075, 0.078, 0.062, 0.055),
}

PARTS = (
    "base",
    "shoulder",
    "upper arm",
    "elbow",
    "forearm",
    "wrist 1",
    "wrist 2",
    "wrist 3",
    "camera's mount",
    "camera",
)
"""Names of the parts of arm and camera. The parts of a gripper follow them."""
_BASE, _SHOULDER, _UPPER, _ELBOW, _FOREARM, _WRIST_1, _WRIST_2, _WRIST_3, _MOUNT, _CAMERA = range(len(PARTS))

# without pairs that cannot touch, or whose distance is fixed
_SELF_PAIRS = np.array(
    [
        *((_BASE, part) for part in (_FOREARM, _WRIST_1, _WRIST_2, _WRIST_3, _MOUNT, _CAMERA)),
        *((_SHOULDER, part) for part in (_FOREARM, _WRIST_1, _WRIST_2, _WRIST_3, _MOUNT, _CAMERA)),
        *((_UPPER, part) for part in (_WRIST_1, _WRIST_2, _WRIST_3, _MOUNT, _CAMERA)),
        *((_ELBOW, part) for part in (_WRIST_2, _WRIST_3, _MOUNT, _CAMERA)),
        *((_FOREARM, part) for part in (_WRIST_3, _MOUNT, _CAMERA)),
        *((_WRIST_1, part) for part in (_MOUNT, _CAMERA)),
        (_WRIST_2, _CAMERA),
    ]
)
# the wrist passes these parts closely by design, and so does a camera beside the wrist
_CLOSE_PAIRS = {
    (_SHOULDER, _FOREARM),
    (_UPPER, _WRIST_1),
    (_FOREARM, _WRIST_3),
    (_WRIST_1, _MOUNT),
    (_WRIST_1, _CAMERA),
    (_WRIST_2, _CAMERA),
}
CLOSE_M = 0.005
"""Clearance of these pairs."""
TABLE_ROUNDING_M = 1e-4
"""Depth below the table at which a fingertip still counts as above it. The flange of a grasp is as exact."""

GRIPPER, FINGERS = "gripper", "gripper's finger"
"""Names of the parts of a gripper: each box of its body, and its fingers."""
# parts that a gripper may touch; its distance from the others is fixed
_GRIPPER_PARTNERS = (_BASE, _SHOULDER, _UPPER, _ELBOW, _FOREARM, _WRIST_1)


@dataclass(frozen=True, eq=False)
class GripperBoxes:
    """Boxes of a gripper on the flange. The last one contains the fingers."""

    R_flange_gripper: NDArray[np.float64]
    """Orientation (3, 3) of the gripper on the flange."""
    centre_m: NDArray[np.float64]
    """Centres (G, 3), in the gripper's orientation, from the middle of the flange."""
    half_m: NDArray[np.float64]
    """Half sizes (G, 3) along the gripper's axes."""
    finger_thickness_m: float
    """Thickness of each finger in the closing direction."""

    def lowest_z(
        self, T_base_flange: NDArray[np.float64], opening_m: NDArray[np.float64] | None
    ) -> NDArray[np.float64]:
        """Return the height (N, G) of each box's lowest corner in the base frame, metres.

        Args:
            T_base_flange: Flange poses (N, 4, 4).
            opening_m: Openings (N,) between the fingers. None means the largest one.
        """
        up = T_base_flange[:, 2, :3] @ self.R_flange_gripper
        half = np.broadcast_to(self.half_m, (len(up), *self.half_m.shape))
        if opening_m is not None:
            half = half.copy()
            half[:, -1, 0] = opening_m / 2 + self.finger_thickness_m
        middle = T_base_flange[:, 2, 3, None] + up @ self.centre_m.T
        return middle - np.einsum("ni,ngi->ng", np.abs(up), half)


@dataclass(frozen=True, eq=False)
class CollisionModel:
    """Capsules of the arm, its camera and its gripper, and what they may collide with."""

    model: ArmModelName
    """Model of the arm."""
    parts: tuple[str, ...]
    """Names (P,) of the parts: `PARTS`, then those of the gripper."""
    part_frames: NDArray[np.int64]
    """Link frame (P, 2) in which each end of a part's axis is given."""
    part_ends: NDArray[np.float64]
    """Ends (P, 2, 3) of the parts' axes in these frames, metres."""
    part_radii: NDArray[np.float64]
    """Radii (P,) of the parts, metres."""
    pairs: NDArray[np.int64]
    """Pairs (S, 2) of parts that may touch each other."""
    gripper: GripperBoxes | None
    """The gripper on the flange, or None for a bare flange."""
    table_z_m: float
    """Height of the table in the base frame."""
    boxes: NDArray[np.float64]
    """Lowest and highest corners (B, 2, 3) of the boxes. The last box may be the workspace, where strings lie."""
    has_workspace: bool
    """Whether the last box is the workspace."""
    contacts: tuple[str, ...]
    """Description (C,) of each contact."""
    contact_parts: NDArray[np.int64]
    """Part (C,) in each contact. Of two parts, it is the one farther from the base."""
    clearances: NDArray[np.float64]
    """Smallest allowed distance (C,) of each contact, metres."""

    def gaps(self, q_rad: NDArray[np.float64], opening_m: NDArray[np.float64] | None = None) -> NDArray[np.float64]:
        """Return the distances (N, C) of all contacts at joint angles (N, 6), metres.

        A negative distance is an overlap. For a box farther away than any clearance, the value is a lower bound.

        Args:
            q_rad: Joint angles (N, 6).
            opening_m: Openings (N,) between the fingers of the gripper. None means the largest one.
        """
        links = link_frames(self.model, q_rad)
        a, b = self._axes(links)
        r = self.part_radii
        one, other = self.pairs.T
        own = segment_distances(a[:, one], b[:, one], a[:, other], b[:, other]) - r[one] - r[other]
        free = slice(_ELBOW, None)  # base and shoulder stand on the table or the pedestal
        table = np.minimum(a[:, free, 2], b[:, free, 2]) - r[free] - self.table_z_m
        if self.gripper is not None:
            table[:, len(PARTS) - _ELBOW :] = self.gripper.lowest_z(links[:, 6], opening_m) - self.table_z_m
        reach = float(r.max() + self.clearances.max())
        boxes = [
            box_distances(a[:, first:], b[:, first:], *box, beyond_m=reach) - r[first:]
            for box, first in zip(self.boxes, self._first_parts(), strict=True)
        ]
        return np.concatenate([own, table, *boxes], axis=1)

    def point_gaps(self, q_rad: NDArray[np.float64], points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the distance (N, P) of each part's surface from the nearest of some points, metres.

        Args:
            q_rad: Joint angles (N, 6).
            points: Points (M, 3) in the base frame, at least one.
        """
        a, b = self._axes(link_frames(self.model, q_rad))
        u = (b - a)[:, :, None]
        w = points - a[:, :, None]
        length = np.maximum((u * u).sum(-1), np.finfo(np.float64).tiny)
        share = ((u * w).sum(-1) / length).clip(0.0, 1.0)
        return np.linalg.norm(w - share[..., None] * u, axis=-1).min(axis=2) - self.part_radii

    def _axes(self, links: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return both ends (N, P, 3) of each part's axis in the base frame, for link frames (N, 7, 4, 4)."""
        frames = links[:, self.part_frames]
        ends = np.einsum("npeij,pej->npei", frames[..., :3, :3], self.part_ends) + frames[..., :3, 3]
        return ends[:, :, 0], ends[:, :, 1]

    @property
    def solid(self) -> NDArray[np.bool_]:
        """Whether each contact (C,) is one of solid bodies, which the workspace is not."""
        not_solid = len(self.parts) - _ELBOW if self.has_workspace else 0
        return np.arange(len(self.contacts)) < len(self.contacts) - not_solid

    def _first_parts(self) -> list[int]:
        # the base cannot avoid a box, and only parts from the elbow on can reach into the workspace
        return [_SHOULDER] * (len(self.boxes) - self.has_workspace) + [_ELBOW] * self.has_workspace


def collision_model(settings: CellSettings, T_flange_camera: NDArray[np.float64]) -> CollisionModel:
    """Return the collision model of a cell for views and moves.

    The gripper is part of it if the settings describe it.

    Args:
        settings: Settings of the cell.
        T_flange_camera: Camera pose on the flange (4, 4).
    """
    described = settings.gripper.to_gripper() if settings.gripper.is_described else None
    return _model(settings, T_flange_camera, described, has_workspace=True)


def grasp_collision_model(
    settings: CellSettings, T_flange_camera: NDArray[np.float64], gripper: Gripper
) -> CollisionModel:
    """Return the collision model of a cell for grasps, in which the workspace is no obstacle.

    The gripper keeps `Gripper.clearance_m` from the table with its body. Its fingertips may come down to the table: the
    planner of the grasps keeps their distance from what it measured.

    Args:
        settings: Settings of the cell. Its gripper is not used.
        T_flange_camera: Camera pose on the flange (4, 4).
        gripper: Gripper on the flange.
    """
    model = _model(settings, T_flange_camera, gripper, has_workspace=False)
    clearances = model.clearances.copy()
    for index, (contact, part) in enumerate(zip(model.contacts, model.contact_parts.tolist(), strict=True)):
        if part >= len(PARTS) and contact.endswith("the table"):
            clearances[index] = -TABLE_ROUNDING_M if model.parts[part] == FINGERS else gripper.clearance_m
    return replace(model, clearances=clearances)


def _model(
    settings: CellSettings, T_flange_camera: NDArray[np.float64], gripper: Gripper | None, *, has_workspace: bool
) -> CollisionModel:
    model, mounting = settings.arm.model, settings.mounting
    build, arm = _BUILDS[model], ARMS[model]
    base_m, up, fore = BASE_RADIUS_M[model], build.upper_arm_beside_m, build.forearm_beside_m
    half, camera_radius = _capsule(np.asarray(settings.camera.body_m))
    R, t = T_flange_camera[:3, :3], T_flange_camera[:3, 3]
    zero = (0.0, 0.0, 0.0)
    # frame and end, frame and end, radius, in the order of PARTS
    shapes = [
        (0, (0.0, 0.0, 0.02), 0, (0.0, 0.0, arm.d_m[0]), base_m),
        (1, zero, 1, (0.0, 0.0, up), base_m),
        (1, (0.0, 0.0, up), 2, (0.0, 0.0, up), build.upper_arm_m),
        (2, (0.0, 0.0, up), 2, (0.0, 0.0, fore), build.elbow_m),
        (2, (0.0, 0.0, fore), 3, (0.0, 0.0, fore), build.forearm_m),
        (3, (0.0, 0.0, fore), 4, zero, build.wrist_m),
        (4, zero, 5, zero, build.wrist_m),
        (5, zero, 6, (0.0, 0.0, -build.wrist_m / 2), build.wrist_m),
        (6, zero, 6, tuple(t), 0.02),
        (6, tuple(t - R @ half), 6, tuple(t + R @ half), camera_radius),
    ]
    parts, pairs, close = PARTS, _SELF_PAIRS, set(_CLOSE_PAIRS)
    gripper_boxes = None if gripper is None else _gripper_boxes(gripper)
    if gripper_boxes is not None:
        count = len(gripper_boxes.centre_m)
        parts = (*PARTS, *[GRIPPER] * (count - 1), FINGERS)
        for centre, size in zip(gripper_boxes.centre_m, 2 * gripper_boxes.half_m, strict=True):
            along, radius = _capsule(size)
            ends = (
                gripper_boxes.R_flange_gripper @ (centre - along),
                gripper_boxes.R_flange_gripper @ (centre + along),
            )
            shapes.append((6, tuple(ends[0]), 6, tuple(ends[1]), radius))
        own = [(part, index) for index in range(len(PARTS), len(parts)) for part in _GRIPPER_PARTNERS]
        pairs = np.concatenate([pairs, own])
        close |= {pair for pair in own if pair[0] == _WRIST_1}
    free, obstructed = range(_ELBOW, len(parts)), range(_SHOULDER, len(parts))
    (x0, x1), (y0, y1), (z0, z1) = settings.workspace_m
    boxes = [np.sort(np.array(box), axis=0) for box in mounting.obstacles_m]
    clear = mounting.clearance_m
    named = [part if part.startswith("wrist") else f"the {part}" for part in parts]
    contacts = [
        (f"{named[one]} comes too near {named[other]}", other, min(clear, CLOSE_M) if pair in close else clear)
        for pair in map(tuple, pairs.tolist())
        for one, other in (pair,)
    ]
    contacts += [(f"{named[part]} comes too near the table", part, clear) for part in free]
    for number in range(1, len(boxes) + 1):
        contacts += [(f"{named[part]} comes too near obstacle {number}", part, clear) for part in obstructed]
    if has_workspace:
        boxes.append(np.array([(x0, y0, z0), (x1, y1, z1)]))
        contacts += [(f"{named[part]} reaches into the workspace", part, 0.0) for part in free]
    return CollisionModel(
        model=model,
        parts=parts,
        part_frames=np.array([(p[0], p[2]) for p in shapes]),
        part_ends=np.array([(p[1], p[3]) for p in shapes], dtype=np.float64),
        part_radii=np.array([p[4] for p in shapes]),
        pairs=pairs,
        gripper=gripper_boxes,
        table_z_m=mounting.table_z_m,
        boxes=np.array(boxes).reshape(-1, 2, 3),
        has_workspace=has_workspace,
        contacts=tuple(contact for contact, _, _ in contacts),
        contact_parts=np.array([part for _, part, _ in contacts]),
        clearances=np.array([clearance for _, _, clearance in contacts]),
    )


def _gripper_boxes(gripper: Gripper) -> GripperBoxes:
    boxes = (*gripper.body, gripper.fingers)
    low, high = (np.array([getattr(box, end) for box in boxes]) for end in ("low_m", "high_m"))
    c, s = np.cos(gripper.mounting_rotation_rad), np.sin(gripper.mounting_rotation_rad)
    R = np.array([(c, -s, 0.0), (s, c, 0.0), (0.0, 0.0, 1.0)])
    return GripperBoxes(R, (low + high) / 2, (high - low) / 2, gripper.finger_thickness_m)


def _capsule(size_m: NDArray[np.float64]) -> tuple[NDArray[np.float64], float]:
    """Return the capsule that contains a box: half its axis (3,), along one side, and its radius."""
    long = int(size_m.argmax())
    width, depth = np.delete(size_m, long).tolist()
    cross = float(np.hypot(width, depth) / 2)
    half = np.zeros(3)
    half[long] = max(size_m[long] / 2 - cross / 4, 0.0)
    return half, float(np.hypot(size_m[long] / 2 - half[long], cross))  # the radius reaches the corners
