"""Plan of a scan: the viewpoints and the joint path through them, complete before anything moves."""

import time
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cell.config.cell_config import CellSettings
from cell.errors import ViewpointsError
from cell.kinematics.collision import CollisionModel
from cell.kinematics.joint_paths import travel_rad
from cell.kinematics.move_duration import path_duration
from cell.planning.candidate_poses import CandidatePose, ViewTarget
from cell.planning.groundwork import Groundwork, groundwork_through, scan_groundwork
from cell.planning.look_at import ring_indices
from cell.planning.tour import Tour, find_tour
from recognition.preprocessing.coverage import CameraFrustum, Coverage, coverage_message, table_coverage

OVERLAP_M = 0.01
"""Largest overlap of the capsules at the start. The capsules are thicker than the arm."""
APPROACH_M = 0.003
"""Further approach that is allowed on the path from a start that is nearer to something than the clearance."""
HOME_TOLERANCE_RAD = 0.002
"""Largest distance of a joint from its home angle at which the arm counts as home."""


@dataclass(frozen=True, eq=False)
class Viewpoint:
    """One pose of the camera in a plan."""

    index: int
    """Number of the viewpoint, from 0."""
    azimuth_rad: float
    """Azimuth of the camera, seen from the middle of the workspace, about z from x."""
    elevation_rad: float
    """Elevation of the camera above the table."""
    distance_m: float
    """Distance of the camera from the middle of the workspace's floor."""
    roll_rad: float
    """Roll of the camera about its optical axis."""
    T_base_camera: NDArray[np.float64]
    """(4, 4) camera pose."""
    T_base_flange: NDArray[np.float64]
    """(4, 4) flange pose."""
    q_rad: NDArray[np.float64] | None
    """Joint angles (6,) at the viewpoint, or None if it is skipped."""
    reason: str | None
    """Why the viewpoint is skipped, or None."""
    fallback: str | None
    """How the pose differs from the preferred one, or None."""


@dataclass(frozen=True, eq=False)
class Leg:
    """One part of the path."""

    view: int | None
    """Index of the viewpoint at its end. None means home."""
    waypoints_rad: NDArray[np.float64]
    """Joint angles (N, 6) of the waypoints, each reached in a straight line in joint space. The last is the end."""
    travel_rad: float
    """Motion of the leading joint, summed over the waypoints."""
    duration_s: float
    """Duration of the motion, at rest at each waypoint, at full speed slider."""
    home_waypoints_rad: NDArray[np.float64]
    """Joint angles (N, 6) of the waypoints from its end home, if the scan ends there. None lead from home, N is 0."""
    home_duration_s: float
    """Duration of the motion along these waypoints."""


@dataclass(frozen=True, eq=False)
class ViewpointPlan:
    """All viewpoints, and the path through the reachable ones."""

    viewpoints: tuple[Viewpoint, ...]
    """Viewpoints in the order of their index."""
    legs: tuple[Leg, ...]
    """Legs in the order of execution. The last one leads home."""
    start_q_rad: NDArray[np.float64]
    """Joint angles (6,) at the start of the first leg, which is home if the arm's posture was unknown."""
    home_q_rad: NDArray[np.float64]
    """Joint angles (6,) of the home posture."""
    travel_rad: float
    """Motion of the leading joint, summed over all legs."""
    duration_s: float
    """Duration of the motion, summed over all legs."""
    coverage: Coverage
    """Coverage of the table by the views of the reachable viewpoints."""
    planning_s: float = field(compare=False)
    """Duration of the planning."""
    first: tuple[int, ...] = ()
    """Indices of the viewpoints of the group that is visited first, in order. Empty if the plan has no such group."""
    held_out: tuple[int, ...] = ()
    """Indices of the viewpoints that verify a calibration and are not used to solve it."""
    warnings: tuple[str, ...] = ()
    """What an operator should know about a plan that can be executed nevertheless."""

    @property
    def reachable(self) -> int:
        """Number of reachable viewpoints."""
        return sum(viewpoint.q_rad is not None for viewpoint in self.viewpoints)

    def is_home(self, q_rad: NDArray[np.float64]) -> bool:
        """Return whether the joint angles (6,) are those of the home posture."""
        return bool(np.abs(q_rad - self.home_q_rad).max() <= HOME_TOLERANCE_RAD)

    @property
    def early_duration_s(self) -> float | None:
        """Duration of the motion if the scan ends after the viewpoints visited first, with the path home, or None."""
        legs = self.legs[: len(self.first)]
        return sum(leg.duration_s for leg in legs) + legs[-1].home_duration_s if legs else None

    @property
    def unseen(self) -> str | None:
        """Message about the part of the workspace that too few views show.

        It is None if all parts are covered, if no viewpoint is reachable, and for a calibration.
        """
        return coverage_message(self.coverage) if self.reachable and not self.held_out else None

    def to_json(self) -> dict[str, Any]:
        """Return the plan as a JSON object."""
        return {
            "reachable": self.reachable,
            "viewpoints": [
                {
                    "index": v.index,
                    "azimuth_rad": round(v.azimuth_rad, 6),
                    "elevation_rad": round(v.elevation_rad, 6),
                    "distance_m": round(v.distance_m, 6),
                    "roll_rad": round(v.roll_rad, 6),
                    "T_base_camera": v.T_base_camera.round(9).tolist(),
                    "T_base_flange": v.T_base_flange.round(9).tolist(),
                    "q_rad": None if v.q_rad is None else v.q_rad.round(9).tolist(),
                    "reason": v.reason,
                    "fallback": v.fallback,
                }
                for v in self.viewpoints
            ],
            "legs": [
                {
                    "view": leg.view,
                    "waypoints_rad": leg.waypoints_rad.round(9).tolist(),
                    "travel_rad": round(leg.travel_rad, 6),
                    "duration_s": round(leg.duration_s, 3),
                    "home_waypoints_rad": leg.home_waypoints_rad.round(9).tolist(),
                    "home_duration_s": round(leg.home_duration_s, 3),
                }
                for leg in self.legs
            ],
            "start_q_rad": self.start_q_rad.round(9).tolist(),
            "home_q_rad": self.home_q_rad.round(9).tolist(),
            "travel_rad": round(self.travel_rad, 6),
            "duration_s": round(self.duration_s, 3),
            "first": list(self.first),
            "early_duration_s": None if self.early_duration_s is None else round(self.early_duration_s, 3),
            "coverage": {"fraction": round(self.coverage.covered_share, 4), "warning": self.unseen},
            "planning_s": round(self.planning_s, 3),
            "held_out": list(self.held_out),
            "warnings": list(self.warnings),
        }


def plan_viewpoints(
    settings: CellSettings,
    T_flange_camera: NDArray[np.float64],
    q_now_rad: ArrayLike | None,
    first: Sequence[Collection[int]] | None = None,
) -> ViewpointPlan:
    """Plan the viewpoints of a scan and the path through them. The same arguments give the same plan.

    Unreachable viewpoints are in the plan with their reason. The part that does not depend on the start is kept for the
    next plans of the same cell.

    Args:
        settings: Settings of the cell.
        T_flange_camera: Camera pose on the flange (4, 4).
        q_now_rad: Joint angles (6,) at the start. None means home.
        first: Alternative groups of viewpoints, as in `plan_through`. None means the two rings if the views are `auto`,
            else no group.

    Raises:
        ViewpointsError: No home posture is free, or no path leads from the start.
    """
    began = time.perf_counter()
    groundwork = scan_groundwork(settings, T_flange_camera)
    if first is None:
        first = ring_indices(settings.scan.viewpoints) if settings.scan.views == "auto" else ()
    return _plan_from(groundwork, q_now_rad, first, began)


def plan_through(
    settings: CellSettings,
    view_target: ViewTarget,
    candidates: Sequence[Iterator[list[CandidatePose]]],
    q_now_rad: ArrayLike | None,
    first: Sequence[Collection[int]] = (),
) -> ViewpointPlan:
    """Plan a path through any viewpoints.

    Args:
        settings: Settings of the cell.
        view_target: Target and camera.
        candidates: Candidate poses of each viewpoint, as `cell.planning.candidate_poses.candidate_levels` gives them.
        q_now_rad: Joint angles (6,) at the start. None means home.
        first: Alternative groups of viewpoints, after which the scan may end. The path visits the reachable viewpoints
            of one group before all others. Groups with fewer reachable viewpoints than another one are not used.

    Raises:
        ViewpointsError: No home posture is free, or no path leads from the start.
    """
    began = time.perf_counter()
    return _plan_from(groundwork_through(settings, view_target, candidates), q_now_rad, first, began)


def _plan_from(
    groundwork: Groundwork, q_now_rad: ArrayLike | None, first: Sequence[Collection[int]], began: float
) -> ViewpointPlan:
    home = groundwork.postures.home_q_rad
    start = home if q_now_rad is None else np.array(q_now_rad, dtype=np.float64)
    start_clearances = _clearances_from(groundwork.collisions, start)
    tour = find_tour(groundwork.postures, start, start_clearances, _reachable_groups(first, groundwork.indices))
    if tour is None:
        raise ViewpointsError(
            "no collision-free path leads from the arm's position to home or to a viewpoint: move "
            "the arm by hand (freedrive) above the workspace, clear of the table and obstacles"
        )
    viewpoints, legs = _taken(groundwork, tour, start)
    return ViewpointPlan(
        viewpoints=viewpoints,
        legs=legs,
        start_q_rad=start,
        home_q_rad=home,
        travel_rad=sum(leg.travel_rad for leg in legs),
        duration_s=sum(leg.duration_s for leg in legs),
        coverage=_coverage(viewpoints, groundwork.view_target),
        planning_s=time.perf_counter() - began,
        first=tuple(groundwork.indices[group] for group, _ in tour.stops[: tour.first]),
    )


def _reachable_groups(first: Sequence[Collection[int]], indices: list[int]) -> list[list[int]]:
    """Return the groups with the most reachable viewpoints, as numbers in `indices`. Empty groups do not count."""
    reachable = [[number for number, index in enumerate(indices) if index in views] for views in first]
    most = max(map(len, reachable), default=0)
    return [group for group in reachable if group and len(group) == most]


def require_enough(plan: ViewpointPlan, min_views: int) -> None:
    """Check that a plan has enough reachable viewpoints.

    Raises:
        ViewpointsError: Fewer than `min_views` are reachable. The message names the others with their reasons.
    """
    if plan.reachable < min_views:
        raise ViewpointsError(
            f"only {plan.reachable} of {len(plan.viewpoints)} viewpoints can be reached, {min_views} are needed: "
            "change x_m, y_m or top_m in [workspace] so that the arm reaches around it, or lower min_views in [scan]. "
            f"Not reached are {describe_missing(plan)}"
        )


def describe_missing(plan: ViewpointPlan) -> str:
    """Return the skipped viewpoints with their reasons, for a message."""
    return "; ".join(f"{v.index}: {v.reason}" for v in plan.viewpoints if v.reason is not None)


def _clearances_from(collisions: CollisionModel, start: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the clearances (C,) that hold on the path from the start."""
    gaps = collisions.gaps(start[None])[0]
    # the arm may stand in the workspace after other work, and may leave it in any direction
    overlap = np.where(collisions.solid, -gaps, 0.0)
    if overlap.max() > OVERLAP_M:
        raise ViewpointsError(
            f"where the arm stands, {collisions.contacts[overlap.argmax()]}: they overlap by {overlap.max():.3f} m. "
            "Move it free by hand (freedrive), or correct table_z_m and obstacles_m in [mounting], body_m in [camera], "
            "or the gripper in [gripper]"
        )
    return np.minimum(collisions.clearances, gaps - APPROACH_M)


def _coverage(viewpoints: tuple[Viewpoint, ...], view_target: ViewTarget) -> Coverage:
    optics, (low, high) = (
        view_target.optics,
        (view_target.centre + [view_target.corners.min(axis=0), view_target.corners.max(axis=0)]),
    )
    frustums = [
        CameraFrustum(optics.K, optics.width, optics.height, v.T_base_camera) for v in viewpoints if v.q_rad is not None
    ]
    x_m, y_m = ((float(low[axis]), float(high[axis])) for axis in range(2))
    return table_coverage(frustums, x_m, y_m, float(view_target.centre[2]), len(viewpoints))


def _taken(
    groundwork: Groundwork, tour: Tour, start: NDArray[np.float64]
) -> tuple[tuple[Viewpoint, ...], tuple[Leg, ...]]:
    """Return all viewpoints, and the legs of the tour through the reachable ones."""
    indices, arm = groundwork.indices, groundwork.postures.arm
    taken = {indices[group]: groundwork.chosen[indices[group]].postures[posture] for group, posture in tour.stops}
    viewpoints = tuple(
        Viewpoint(
            index=index,
            azimuth_rad=choice.pose.azimuth_rad,
            elevation_rad=choice.pose.elevation_rad,
            distance_m=choice.pose.distance_m,
            roll_rad=choice.pose.roll_rad,
            T_base_camera=choice.pose.T_base_camera,
            T_base_flange=choice.pose.T_base_flange,
            q_rad=taken.get(index),
            reason=choice.reason,
            fallback=choice.pose.fallback,
        )
        for index, choice in enumerate(groundwork.chosen)
    )
    ends = [*(indices[group] for group, _ in tour.stops), None]
    legs, q_rad = [], start
    for view, path, home_path in zip(ends, tour.paths, (*tour.home_paths, ()), strict=True):
        passed = [
            q for q, before in zip(path, (q_rad, *path), strict=False) if q is path[-1] or not np.array_equal(q, before)
        ]
        end = path[-1]
        legs.append(
            Leg(
                view=view,
                waypoints_rad=np.array(passed),
                travel_rad=travel_rad(q_rad, path),
                duration_s=path_duration(arm, q_rad, path),
                home_waypoints_rad=np.array(home_path).reshape(-1, 6),
                home_duration_s=path_duration(arm, end, home_path),
            )
        )
        q_rad = end
    return viewpoints, tuple(legs)
