"""Exact distance of the gripper from the true scene during the approach, without physics."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cell.simulation.evaluation.curve_distance import Polyline
from cell.simulation.grasp_physics.pieces import distance_along
from cell.simulation.grasp_physics.settings import NO_ERROR, RobotError
from cell.simulation.grasp_physics.trial import PlannedGrasp, is_gripped_strand
from cell.simulation.rendering.meshes import clump_mesh
from cell.simulation.scenes.clutter import Box
from cell.simulation.scenes.scenes import StringScene
from recognition.grasping.gripper import Gripper

SWEEP_M = 0.2
"""Length of the swept boxes against the approach direction."""


@dataclass(frozen=True)
class Clearance:
    """Smallest distances of fingers and palm, swept along the approach, from the true scene, metres.

    A distance from a strand is negative if the strand reaches into the gripper, down to minus its radius. A distance is
    infinite if there is nothing of the kind.
    """

    table_m: float
    """Height of the lowest point of the gripper above the table. It is negative below the table."""
    object_m: float
    """Distance from boxes and clumps. It is 0 if the gripper meets one, or if one is between the fingers."""
    other_strand_m: float
    """Distance from other strings, and from distant parts of the same string. The space between the fingers belongs to
    the gripper here."""
    gripped_strand_m: float
    """Distance from the gripped strand, while the fingers are open."""

    @property
    def clean(self) -> bool:
        """Whether the gripper touches nothing on its approach."""
        return min(self.table_m, self.object_m, self.other_strand_m, self.gripped_strand_m) > 0


def approach_clearance(
    scene: StringScene, grasp: PlannedGrasp, gripper: Gripper, error: RobotError = NO_ERROR
) -> Clearance:
    """Return the distances of the gripper from the true scene while it approaches and before it closes.

    The strings are sampled every 0.5 mm, which is exact to 0.01 mm. Clumps are exact to half a cell of their surface.

    Args:
        scene: True scene.
        grasp: Grasp to carry out.
        gripper: Dimensions of the gripper.
        error: Error of the robot.
    """
    T_base_grasp = error.apply(grasp.T_base_grasp)
    fingers, palm = _swept_boxes(grasp, gripper)
    closing = _Extent(np.minimum(fingers[0].low, fingers[1].low), np.maximum(fingers[0].high, fingers[1].high))
    other, gripped = [np.inf], [np.inf]
    for string, (curve, closed, radius_m) in enumerate(zip(scene.curves, scene.closed, scene.radii_m, strict=True)):
        line = Polyline.of(curve, closed)
        points = line.densely_sampled()
        is_gripped = np.zeros(len(points), dtype=bool)
        if string == grasp.string:
            s = np.linspace(0.0, line.length_m, len(points))
            along = distance_along(s, grasp.s_m, line.length_m, closed)
            is_gripped = is_gripped_strand(along, points, grasp, gripper)
        local = _in_frame(points, T_base_grasp)
        to_palm = palm.distance(local)
        distance = np.minimum(closing.distance(local), to_palm) - radius_m
        other.append(float(distance[~is_gripped].min(initial=np.inf)))
        distance = np.minimum.reduce([fingers[0].distance(local), fingers[1].distance(local), to_palm]) - radius_m
        gripped.append(float(distance[is_gripped].min(initial=np.inf)))
    objects = [np.inf, *_object_distances(scene, T_base_grasp, (closing, palm))]
    lowest = min(float(box.corners(T_base_grasp)[:, 2].min()) for box in (*fingers, palm))
    return Clearance(lowest, min(objects), min(other), min(gripped))


@dataclass(frozen=True, eq=False)
class _Extent:
    """A box along the axes of a frame."""

    low: NDArray[np.float64]
    """(3,) smallest coordinates, metres."""
    high: NDArray[np.float64]
    """(3,) largest coordinates, metres."""

    def distance(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the distances (N,) of points (N, 3) in the frame of the box, 0 inside."""
        return np.linalg.norm(np.maximum(np.maximum(self.low - points, points - self.high), 0.0), axis=1)

    def corners(self, T: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the corners (8, 3) of the box in the frame to which `T` (4, 4) maps."""
        unit = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])
        return (self.low + unit * (self.high - self.low)) @ T[:3, :3].T + T[:3, 3]


def _swept_boxes(grasp: PlannedGrasp, gripper: Gripper) -> tuple[tuple[_Extent, _Extent], _Extent]:
    """Return the swept boxes of the two fingers and of the palm, in the grasp frame."""
    inner, y = grasp.opening_m / 2, gripper.finger_width_m / 2
    outer = inner + gripper.finger_thickness_m
    left = _Extent(np.array([-outer, -y, -SWEEP_M]), np.array([-inner, y, grasp.reach_m]))
    right = _Extent(np.array([inner, -y, -SWEEP_M]), np.array([outer, y, grasp.reach_m]))
    x, y = gripper.stroke_m / 2 + gripper.finger_thickness_m, gripper.palm_width_m / 2
    palm = _Extent(np.array([-x, -y, -SWEEP_M]), np.array([x, y, grasp.reach_m - gripper.finger_depth_m]))
    return (left, right), palm


def _in_frame(points: NDArray[np.float64], T: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return `points` (N, 3) in the frame that `T` (4, 4) maps from."""
    return (points - T[:3, 3]) @ T[:3, :3]


def _object_distances(
    scene: StringScene, T_base_grasp: NDArray[np.float64], parts: tuple[_Extent, ...]
) -> Iterator[float]:
    """Yield the distances of the swept boxes from the objects of the scene."""
    for box in scene.boxes:
        for part in parts:
            yield _box_distance(part, T_base_grasp, box)
    for clump in scene.clumps:
        vertices, triangles = clump_mesh(clump)
        points = np.vstack([vertices[np.unique(triangles)], vertices[triangles].mean(axis=1)]).astype(np.float64)
        for part in parts:
            yield float(part.distance(_in_frame(points, T_base_grasp)).min())


def _box_distance(part: _Extent, T_base_grasp: NDArray[np.float64], box: Box) -> float:
    """Return the distance between a swept box and a box on the table, 0 if they overlap.

    The nearest pair of points is the solution of a least-squares problem with bounds on the six box coordinates.
    """
    from scipy.optimize import lsq_linear

    c, s = np.cos(box.yaw_rad), np.sin(box.yaw_rad)
    R_box = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    width, depth, height = box.size_m
    low = np.concatenate([part.low, [-width / 2, -depth / 2, 0.0]])
    high = np.concatenate([part.high, [width / 2, depth / 2, height]])
    found = lsq_linear(
        np.hstack([T_base_grasp[:3, :3], -R_box]), np.array([*box.centre_m, 0.0]) - T_base_grasp[:3, 3], (low, high),
        method="bvls", tol=1e-14,
    )  # fmt: skip
    distance_m = float(np.sqrt(2 * found.cost))
    return distance_m if distance_m > 1e-9 else 0.0
