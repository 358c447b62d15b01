"""True clearance of grasps: the distances of the gripper on its approach from the objects of a simulated scene.

The gripper consists of three boxes: two fingers and a palm. Each approaches straight along z of the grasp frame, so its
swept volume is a longer box. Distances of these boxes from the table and from boxes are exact. A string is a tube with
square ends. Its side counts as spheres every 0.25 mm along the centre line, and the last radius at each end as surface
points 0.25 mm apart. So a distance from a string is at most 0.02 mm too large beside it, and 0.18 mm at its ends.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cell.kinematics.capsule_distance import segment_distances
from cell.simulation.scenes.clutter import Box
from cell.simulation.scenes.planar_crossings import is_closed
from cell.simulation.scenes.scenes import StringScene
from recognition.geometry.polyline import arc_length, resample
from recognition.grasping.gripper import Gripper
from recognition.model.grasps import ScoredGrasp

APPROACH_M = 0.1
"""Length of the straight approach. It is longer than the highest object of a scene."""
FAR_M = 0.05
"""Distances above this are reported as this."""
_STEP_M = 0.00025
"""Step along a string, and of the surface points at its ends."""
_CORNERS = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])
_EDGES = np.array([(i, j) for i in range(8) for j in range(i + 1, 8) if np.abs(_CORNERS[i] - _CORNERS[j]).sum() == 1])


@dataclass(frozen=True)
class PartClearance:
    """Smallest true distances of one part of the gripper over the approach, metres.

    A distance of 0 or less is a contact. Distances above `FAR_M` are reported as `FAR_M`.
    """

    table_m: float
    """Height of its lowest point above the table. Negative: below the table."""
    box_m: float
    """Distance from the nearest box, 0 inside."""
    string_m: float
    """Distance from the surface of the nearest strand that is not gripped. Negative: the part penetrates the strand."""
    gripped_m: float
    """Distance from the surface of the gripped strand. Negative: the part penetrates it."""

    @property
    def contact(self) -> tuple[str, ...]:
        """What the part touches: `table`, `box`, `string` or `gripped`."""
        distances = (
            ("table", self.table_m),
            ("box", self.box_m),
            ("string", self.string_m),
            ("gripped", self.gripped_m),
        )
        return tuple(name for name, distance_m in distances if distance_m <= 0)

    @property
    def obstacle_m(self) -> float:
        """Distance from the nearest table, box or strand that is not gripped."""
        return min(self.table_m, self.box_m, self.string_m)


@dataclass(frozen=True)
class GraspClearance:
    """True clearance of one grasp."""

    fingers: PartClearance
    """Smaller of the distances of both fingers."""
    palm: PartClearance
    """Distances of the palm."""
    between: PartClearance
    """Distances of the space between the open fingers, through which they close. Its `gripped_m` is `FAR_M`."""
    string: int
    """Index of the string whose centre line is nearest to the origin of the grasp."""
    off_m: float
    """Distance of the origin of the grasp from this centre line."""
    hold_m: float
    """Smallest distance, along the approach, of the fingertips beyond the centre line of the gripped strand, over the
    width of the fingers. Negative: the fingertips are above the centre line. Minus infinity: there is no strand."""

    @property
    def touches(self) -> bool:
        """Whether a finger or the palm touches the table, a box or a strand that is not gripped.

        The fingers may touch it on the approach, or while they close.
        """
        return min(self.fingers.obstacle_m, self.palm.obstacle_m, self.between.obstacle_m) <= 0

    @property
    def is_clean(self) -> bool:
        """Whether nothing is touched, not even the gripped strand before the fingers close."""
        return not self.touches and min(self.fingers.gripped_m, self.palm.gripped_m) > 0

    @property
    def finger_contact(self) -> tuple[str, ...]:
        """What a finger touches on the approach or while the fingers close: `table`, `box`, `string` or `gripped`."""
        return tuple(dict.fromkeys(self.fingers.contact + self.between.contact))


def grasp_clearances(
    grasps: Sequence[ScoredGrasp],
    scene: StringScene,
    gripper: Gripper,
    T_grasp_actual: NDArray[np.float64] | None = None,
    approach_m: float = APPROACH_M,
) -> list[GraspClearance]:
    """Return the true clearances of grasps over their straight approach, before the fingers close.

    A part of the gripped string counts as another strand if it is farther away along the string than twice its distance
    from the grasp plus the width of a finger, as in the grasp planner. Clumps do not count; scenes with strings have
    none.

    Args:
        grasps: Grasps in the base frame.
        scene: True scene. The table is at z = 0.
        gripper: Dimensions of the gripper.
        T_grasp_actual: (4, 4) error of the robot: pose that the gripper takes, in the frame of the requested grasp.
            None: no error.
        approach_m: Length of the approach. The palm is followed over the same length.

    Returns:
        One clearance for each grasp, in their order.
    """
    strands = [_Tube.of(curve, radius_m) for curve, radius_m in zip(scene.curves, scene.radii_m, strict=True)]
    error = np.eye(4) if T_grasp_actual is None else T_grasp_actual
    return [_clearance(grasp, error, scene.boxes, strands, gripper, approach_m) for grasp in grasps]


def oriented_box_distance(
    T_base_box: NDArray[np.float64],
    low: NDArray[np.float64],
    high: NDArray[np.float64],
    T_base_other: NDArray[np.float64],
    other_low: NDArray[np.float64],
    other_high: NDArray[np.float64],
) -> float:
    """Return the exact distance between two boxes, 0 if they overlap.

    Disjoint convex polyhedra are nearest at a corner of one and a face of the other, or at two edges.

    Args:
        T_base_box: (4, 4) frame of the first box.
        low: (3,) lowest corner of the first box in its frame, metres.
        high: (3,) highest corner.
        T_base_other: (4, 4) frame of the second box.
        other_low: (3,) lowest corner of the second box in its frame, metres.
        other_high: (3,) highest corner.
    """
    corners, other_corners = _box_corners(T_base_box, low, high), _box_corners(T_base_other, other_low, other_high)
    if not _separable(corners, other_corners, T_base_box[:3, :3], T_base_other[:3, :3]):
        return 0.0
    edges, other_edges = corners[_EDGES], other_corners[_EDGES]
    between_edges = segment_distances(
        edges[:, None, 0], edges[:, None, 1], other_edges[None, :, 0], other_edges[None, :, 1]
    )
    return float(
        min(
            point_box_distance(corners, T_base_other, other_low, other_high).min(),
            point_box_distance(other_corners, T_base_box, low, high).min(),
            between_edges.min(),
        )
    )


def point_box_distance(
    points: NDArray[np.float64], T_base_box: NDArray[np.float64], low: NDArray[np.float64], high: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the distances (N,) of points (N, 3) from a box, 0 inside. `low` and `high` (3,) are in its frame."""
    local = (points - T_base_box[:3, 3]) @ T_base_box[:3, :3]
    return np.linalg.norm(np.maximum(np.maximum(low - local, local - high), 0.0), axis=1)


@dataclass(frozen=True, eq=False)
class _Tube:
    """A string as spheres along its side and as surface points near its ends."""

    centre: NDArray[np.float64]
    """(N, 3) centres of the spheres and surface points."""
    radius_m: NDArray[np.float64]
    """(N,) radius of each sphere, and 0 for a surface point."""
    s_m: NDArray[np.float64]
    """(N,) arc length of each."""
    line: NDArray[np.float64]
    """(M, 3) centre line in fine steps."""
    line_s_m: NDArray[np.float64]
    """(M,) arc length of each point of the centre line."""
    length_m: float
    closed: bool

    @classmethod
    def of(cls, curve: NDArray[np.float64], radius_m: float) -> "_Tube":
        line = resample(curve, _STEP_M)
        s = arc_length(line)
        length_m, closed = float(s[-1]), is_closed(curve)
        inside = np.ones(len(line), dtype=bool) if closed else (s >= radius_m) & (s <= length_m - radius_m)
        centre, radius, at = [line[inside]], [np.full(np.count_nonzero(inside), radius_m)], [s[inside]]
        if not closed:
            for points, end_m in ((line[s < radius_m], 0.0), (line[s > length_m - radius_m][::-1], length_m)):
                surface = _end_surface(points, radius_m)
                centre.append(surface)
                radius.append(np.zeros(len(surface)))
                at.append(np.full(len(surface), end_m))
        return cls(np.vstack(centre), np.concatenate(radius), np.concatenate(at), line, s, length_m, closed)

    def along(self, s_m: NDArray[np.float64], t_m: float) -> NDArray[np.float64]:
        """Return the distances (N,) along the string."""
        apart = np.abs(s_m - t_m)
        return np.minimum(apart, self.length_m - apart) if self.closed else apart


def _end_surface(points: NDArray[np.float64], radius_m: float) -> NDArray[np.float64]:
    """Return surface points (N, 3) of the end of a tube: its side around `points` (M, 3), and its square face."""
    tangent = points[0] - points[min(4, len(points) - 1)]
    tangent /= np.linalg.norm(tangent)
    side = np.cross(tangent, (0.0, 0.0, 1.0))
    side /= np.linalg.norm(side)
    up = np.cross(side, tangent)

    def ring(at_radius_m: float) -> NDArray[np.float64]:
        angle = np.linspace(0, 2 * np.pi, max(int(np.ceil(2 * np.pi * at_radius_m / _STEP_M)), 1), endpoint=False)
        return at_radius_m * (np.cos(angle)[:, None] * side + np.sin(angle)[:, None] * up)

    face = np.vstack([ring(rho) for rho in np.linspace(0, radius_m, int(np.ceil(radius_m / _STEP_M)) + 1)])
    return np.vstack([(points[:, None] + ring(radius_m)).reshape(-1, 3), points[0] + face])


def _clearance(
    grasp: ScoredGrasp,
    error: NDArray[np.float64],
    boxes: Sequence[Box],
    strands: Sequence[_Tube],
    gripper: Gripper,
    approach_m: float,
) -> GraspClearance:
    T = grasp.T_base_grasp @ error
    # the strand that the planner meant is the one at the requested pose
    string, s_m, off_m = _nearest_strand(strands, grasp.T_base_grasp[:3, 3])
    half, reach = grasp.opening_m / 2, grasp.reach_m
    width, outer = gripper.finger_width_m / 2, grasp.opening_m / 2 + gripper.finger_thickness_m
    top = reach - gripper.finger_depth_m
    widest, palm = gripper.stroke_m / 2 + gripper.finger_thickness_m, gripper.palm_width_m / 2
    parts = {
        "left": ((-outer, -width, top - approach_m), (-half, width, reach)),
        "right": ((half, -width, top - approach_m), (outer, width, reach)),
        "palm": ((-widest, -palm, top - approach_m), (widest, palm, top)),
        "between": ((-half, -width, top - approach_m), (half, width, reach)),
    }
    found = {
        name: _part_clearance(T, np.array(low), np.array(high), boxes, strands, string, s_m, gripper)
        for name, (low, high) in parts.items()
    }
    left, right = found["left"], found["right"]
    fingers = PartClearance(
        min(left.table_m, right.table_m),
        min(left.box_m, right.box_m),
        min(left.string_m, right.string_m),
        min(left.gripped_m, right.gripped_m),
    )
    between = replace(found["between"], gripped_m=FAR_M)
    hold_m = _hold_m(T, reach, strands, string, s_m, gripper)
    return GraspClearance(fingers, found["palm"], between, string, off_m, hold_m)


def _part_clearance(
    T: NDArray[np.float64],
    low: NDArray[np.float64],
    high: NDArray[np.float64],
    boxes: Sequence[Box],
    strands: Sequence[_Tube],
    gripped: int,
    s_m: float,
    gripper: Gripper,
) -> PartClearance:
    """Return the clearances of the box from `low` to `high` (3,) in the frame `T` (4, 4)."""
    table_m = float(_box_corners(T, low, high)[:, 2].min())
    box_m = string_m = gripped_m = FAR_M
    centre, size = T[:3, :3] @ (low + high) / 2 + T[:3, 3], float(np.linalg.norm(high - low)) / 2
    for box in boxes:
        T_box, box_low, box_high = _box_frame(box)
        middle = T_box[:3, :3] @ (box_low + box_high) / 2 + T_box[:3, 3]
        if np.linalg.norm(middle - centre) - size - np.linalg.norm(box_high - box_low) / 2 < box_m:
            box_m = min(box_m, oriented_box_distance(T, low, high, T_box, box_low, box_high))
    for k, tube in enumerate(strands):
        distance = point_box_distance(tube.centre, T, low, high) - tube.radius_m
        own = np.zeros(len(distance), dtype=bool)
        if k == gripped:
            apart = np.linalg.norm(tube.centre - T[:3, 3], axis=1)
            own = tube.along(tube.s_m, s_m) <= 2 * apart + gripper.finger_width_m
            gripped_m = min(gripped_m, float(distance[own].min(initial=FAR_M)))
        string_m = min(string_m, float(distance[~own].min(initial=FAR_M)))
    return PartClearance(min(table_m, FAR_M), box_m, string_m, gripped_m)


def _nearest_strand(strands: Sequence[_Tube], point: NDArray[np.float64]) -> tuple[int, float, float]:
    """Return the nearest string, the arc length of its nearest point, and the distance. -1 without a string."""
    best = (-1, 0.0, np.inf)
    for k, tube in enumerate(strands):
        distance = np.linalg.norm(tube.line - point, axis=1)
        nearest = int(np.argmin(distance))
        if distance[nearest] < best[2]:
            best = (k, float(tube.line_s_m[nearest]), float(distance[nearest]))
    return best


def _hold_m(
    T: NDArray[np.float64], reach_m: float, strands: Sequence[_Tube], string: int, s_m: float, gripper: Gripper
) -> float:
    """Return the smallest distance of the fingertips beyond the gripped centre line, metres."""
    if string < 0:
        return -np.inf
    tube = strands[string]
    near = tube.line[tube.along(tube.line_s_m, s_m) <= 2 * gripper.finger_width_m]
    local = (near - T[:3, 3]) @ T[:3, :3]
    between = np.abs(local[:, 1]) <= gripper.finger_width_m / 2
    return float((reach_m - local[between, 2]).min()) if between.any() else -np.inf


def _box_frame(box: Box) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return the frame (4, 4) of a box that stands on the table, and its lowest and highest corner in this frame."""
    c, s = np.cos(box.yaw_rad), np.sin(box.yaw_rad)
    T = np.eye(4)
    T[:2, :2] = ((c, -s), (s, c))
    T[:2, 3] = box.centre_m
    width, depth, height = box.size_m
    return T, np.array([-width / 2, -depth / 2, 0.0]), np.array([width / 2, depth / 2, height])


def _box_corners(T: NDArray[np.float64], low: NDArray[np.float64], high: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the corners (8, 3) of a box in the base frame."""
    return (low + _CORNERS * (high - low)) @ T[:3, :3].T + T[:3, 3]


def _separable(
    corners: NDArray[np.float64], other: NDArray[np.float64], R: NDArray[np.float64], R_other: NDArray[np.float64]
) -> bool:
    """Return whether a plane separates two boxes (separating axis theorem: face normals and products of edges)."""
    axes = np.vstack([R.T, R_other.T, np.cross(R.T[:, None], R_other.T[None]).reshape(-1, 3)])
    axes = axes[np.linalg.norm(axes, axis=1) > 1e-9]
    a, b = corners @ axes.T, other @ axes.T
    return bool(((a.max(axis=0) < b.min(axis=0)) | (b.max(axis=0) < a.min(axis=0))).any())
