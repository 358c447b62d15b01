"""Distances of the arm and its camera from each other, the table and obstacles, for many postures at once.

The parts of the arm are capsules, which are a little thicker than the arm. A capsule contains all points within a
radius of a line segment.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cell.config.arm_config import BASE_RADIUS_M, ArmModelName
from cell.config.cell_config import CellSettings
from cell.kinematics.capsule_distance import box_distances, segment_distances
from cell.kinematics.ur_kinematics import ARMS, link_frames


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

# base and shoulder stand on the table or the pedestal
_FREE_PARTS = np.arange(_ELBOW, len(PARTS))


@dataclass(frozen=True, eq=False)
class CollisionModel:
    """Capsules of the arm and its camera, and what they may collide with."""

    model: ArmModelName
    """Model of the arm."""
    part_frames: NDArray[np.int64]
    """Link frame (P, 2) in which each end of a part's axis is given."""
    part_ends: NDArray[np.float64]
    """Ends (P, 2, 3) of the parts' axes in these frames, metres."""
    part_radii: NDArray[np.float64]
    """Radii (P,) of the parts, metres."""
    table_z_m: float
    """Height of the table in the base frame."""
    boxes: NDArray[np.float64]
    """Lowest and highest corners (B, 2, 3) of the boxes. The last box is the workspace, in which the strings lie."""
    contacts: tuple[str, ...]
    """Description (C,) of each contact."""
    clearances: NDArray[np.float64]
    """Smallest allowed distance (C,) of each contact, metres."""

    def gaps(self, q_rad: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the distances (N, C) of all contacts at joint angles (N, 6), metres.

        A negative distance is an overlap. For a box farther away than any clearance, the value is a lower bound.
        """
        frames = link_frames(self.model, q_rad)[:, self.part_frames]
        ends = np.einsum("npeij,pej->npei", frames[..., :3, :3], self.part_ends) + frames[..., :3, 3]
        a, b, r = ends[:, :, 0], ends[:, :, 1], self.part_radii
        one, other = _SELF_PAIRS.T
        own = segment_distances(a[:, one], b[:, one], a[:, other], b[:, other]) - r[one] - r[other]
        free = _FREE_PARTS
        table = np.minimum(a[:, free, 2], b[:, free, 2]) - r[free] - self.table_z_m
        reach = float(r.max() + self.clearances.max())
        boxes = [
            box_distances(a[:, first:], b[:, first:], *box, beyond_m=reach) - r[first:]
            for box, first in zip(self.boxes, self._first_parts(), strict=True)
        ]
        return np.concatenate([own, table, *boxes], axis=1)

    @property
    def solid(self) -> NDArray[np.bool_]:
        """Whether each contact (C,) is one of solid bodies, which the workspace is not."""
        return np.arange(len(self.contacts)) < len(self.contacts) - len(PARTS[_ELBOW:])

    def _first_parts(self) -> list[int]:
        # the base cannot avoid a box, and only parts from the elbow on can reach into the workspace
        return [_SHOULDER] * (len(self.boxes) - 1) + [_ELBOW]


def collision_model(settings: CellSettings, T_flange_camera: NDArray[np.float64]) -> CollisionModel:
    """Return the collision model of a cell with the camera at `T_flange_camera` (4, 4)."""
    model, mounting = settings.arm.model, settings.mounting
    build, arm = _BUILDS[model], ARMS[model]
    base_m, up, fore = BASE_RADIUS_M[model], build.upper_arm_beside_m, build.forearm_beside_m
    size = np.asarray(settings.camera.body_m)
    long = int(size.argmax())
    across = np.delete(size, long)
    cross = float(np.hypot(*across) / 2)
    half = np.zeros(3)
    half[long] = max(size[long] / 2 - cross / 4, 0.0)
    camera_radius = float(np.hypot(size[long] / 2 - half[long], cross))  # contains the corners of the body
    R, t = T_flange_camera[:3, :3], T_flange_camera[:3, 3]
    zero = (0.0, 0.0, 0.0)
    # frame and end, frame and end, radius, in the order of PARTS
    parts = [
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
    (x0, x1), (y0, y1), (z0, z1) = settings.workspace_m
    obstacles = [np.sort(np.array(box), axis=0) for box in mounting.obstacles_m]
    boxes = np.array([*obstacles, [(x0, y0, z0), (x1, y1, z1)]])
    clear = mounting.clearance_m
    contacts = [f"the {PARTS[one]} comes too near the {PARTS[other]}" for one, other in _SELF_PAIRS]
    clearances = [min(clear, CLOSE_M) if (one, other) in _CLOSE_PAIRS else clear for one, other in _SELF_PAIRS.tolist()]
    contacts += [f"the {PARTS[part]} comes too near the table" for part in _FREE_PARTS]
    clearances += [clear] * len(_FREE_PARTS)
    for number in range(1, len(obstacles) + 1):
        contacts += [f"the {part} comes too near obstacle {number}" for part in PARTS[_SHOULDER:]]
        clearances += [clear] * len(PARTS[_SHOULDER:])
    contacts += [f"the {part} reaches into the workspace" for part in PARTS[_ELBOW:]]
    clearances += [0.0] * len(PARTS[_ELBOW:])
    return CollisionModel(
        model=model,
        part_frames=np.array([(p[0], p[2]) for p in parts]),
        part_ends=np.array([(p[1], p[3]) for p in parts], dtype=np.float64),
        part_radii=np.array([p[4] for p in parts]),
        table_z_m=mounting.table_z_m,
        boxes=boxes,
        contacts=tuple(contacts),
        clearances=np.array(clearances),
    )
