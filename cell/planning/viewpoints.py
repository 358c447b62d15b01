"""From where the camera looks at the workspace, and how the arm gets there: planned whole before anything moves."""

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cell.config.cell_config import CellSettings
from cell.errors import ViewpointsError
from cell.kinematics.collision import CollisionModel, collision_model
from cell.kinematics.joint_paths import JointPaths, travel_rad
from cell.planning.candidate_poses import PoseToTry, Sight, poses_to_try
from cell.planning.home import find_home
from cell.planning.pose_selection import PoseChoice, choose_poses
from cell.planning.tour import Route, best_route
from recognition.preprocessing.coverage import CameraFrustum, Coverage, coverage_message, table_coverage

OVERLAP_M = 0.01
"""Where the arm stands its capsules, thicker than itself, may overlap something by this."""
APPROACH_M = 0.003
"""Leaving a place nearer to something than the clearance, it may come still nearer by this."""


@dataclass(frozen=True, eq=False)
class Viewpoint:
    """One pose from which the camera is to look."""

    index: int
    azimuth_rad: float
    """Of the camera, seen from the workspace's middle, about z from x."""
    elevation_rad: float
    """Above the table."""
    distance_m: float
    """From the middle of the workspace's floor."""
    roll_rad: float
    """About the optical axis."""
    T_base_camera: NDArray[np.float64]
    T_base_flange: NDArray[np.float64]
    q_rad: NDArray[np.float64] | None
    """Joint angles (6,) there; None: not taken."""
    reason: str | None
    """Why it is not taken, in words."""
    fallback: str | None
    """How it differs from what was wanted, in words."""


@dataclass(frozen=True, eq=False)
class Leg:
    """One stretch of the way."""

    view: int | None
    """Index of the viewpoint at its end; None: home."""
    waypoints_rad: NDArray[np.float64]
    """(N, 6) joint angles to pass, each reached in a straight line in joint space; the last is the end."""
    travel_rad: float
    """The leading joint's turns, together."""


@dataclass(frozen=True, eq=False)
class ViewpointPlan:
    """All viewpoints, and the way through those that can be reached."""

    viewpoints: tuple[Viewpoint, ...]
    """By index."""
    legs: tuple[Leg, ...]
    """In the order of execution; the last leads home."""
    start_q_rad: NDArray[np.float64]
    """(6,): where the first leg begins; home unless the arm's place was known."""
    home_q_rad: NDArray[np.float64]
    """(6,)."""
    travel_rad: float
    """Of all legs."""
    coverage: Coverage
    """Of what is looked at, lying on the table, by the pictures from the viewpoints that are taken."""
    planning_s: float = field(compare=False)
    held_out: tuple[int, ...] = ()
    """Indices of the viewpoints whose pictures judge a calibration that is solved without them."""
    warnings: tuple[str, ...] = ()
    """What an operator should know of a plan that can be carried out all the same."""

    @property
    def reached(self) -> int:
        """How many viewpoints are taken."""
        return sum(viewpoint.q_rad is not None for viewpoint in self.viewpoints)

    @property
    def unseen(self) -> str | None:
        """In words, which part of the workspace too few pictures show; None where they show all, or there are none, and
        for a calibration."""
        return coverage_message(self.coverage) if self.reached and not self.held_out else None

    def to_json(self) -> dict[str, Any]:
        """Plain numbers and words."""
        return {
            "reached": self.reached,
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
                }
                for leg in self.legs
            ],
            "start_q_rad": self.start_q_rad.round(9).tolist(),
            "home_q_rad": self.home_q_rad.round(9).tolist(),
            "travel_rad": round(self.travel_rad, 6),
            "coverage": {"share": round(self.coverage.covered_share, 4), "warning": self.unseen},
            "planning_s": round(self.planning_s, 3),
            "held_out": list(self.held_out),
            "warnings": list(self.warnings),
        }


def plan_viewpoints(
    settings: CellSettings, T_flange_camera: NDArray[np.float64], q_now_rad: ArrayLike | None
) -> ViewpointPlan:
    """The viewpoints of a scan with the camera mounted so, and the way from `q_now_rad` (6,), or home, and home again.

    Viewpoints that cannot be reached are in the plan with their reason. Nothing moves. The same arguments give the
    same plan.

    Raises:
        ViewpointsError: no home posture is free, or no way leads from where the arm stands.
    """
    sight = Sight.of(settings, settings.camera.optics, T_flange_camera)
    return plan_through(settings, sight, poses_to_try(sight, settings.scan.views), q_now_rad)


def plan_through(
    settings: CellSettings, sight: Sight, tries: Sequence[Iterator[list[PoseToTry]]], q_now_rad: ArrayLike | None
) -> ViewpointPlan:
    """The same for any viewpoints that look at `sight`: for each, its poses as of
    `cell.planning.candidate_poses.tries`."""
    began = time.perf_counter()
    collisions = collision_model(settings, sight.T_flange_camera)
    home = _home(settings, collisions, sight)
    start = home if q_now_rad is None else np.array(q_now_rad, dtype=np.float64)
    start_clearances = _clearances_from(collisions, start)

    paths = JointPaths(collisions, home)
    chosen = choose_poses(tries, collisions, paths, home)
    groups = {index: choice.postures for index, choice in enumerate(chosen) if choice.reason is None}
    route = best_route(start, home, list(groups.values()), paths, start_clearances)
    if route is None:
        raise ViewpointsError(
            "no free way leads from where the arm stands to home or to a viewpoint: move it by hand (freedrive) to "
            "above the workspace, clear of the table and obstacles"
        )
    viewpoints, legs = _taken(chosen, list(groups), list(groups.values()), route, start)
    travel = sum(leg.travel_rad for leg in legs)
    coverage = _coverage(viewpoints, sight)
    return ViewpointPlan(viewpoints, legs, start, home, travel, coverage, time.perf_counter() - began)


def home_posture(settings: CellSettings, T_flange_camera: NDArray[np.float64]) -> NDArray[np.float64]:
    """Joint angles (6,) at which a scan ends: the configured ones, else found.

    Raises:
        ViewpointsError: the configured ones are not free, or none are.
    """
    collisions = collision_model(settings, T_flange_camera)
    return _home(settings, collisions, Sight.of(settings, settings.camera.optics, T_flange_camera))


def require_enough(plan: ViewpointPlan, min_views: int) -> None:
    """Refuses a plan with too few viewpoints.

    Raises:
        ViewpointsError: fewer than `min_views` can be reached; names each that cannot, with its reason.
    """
    if plan.reached < min_views:
        raise ViewpointsError(
            f"only {plan.reached} of {len(plan.viewpoints)} viewpoints can be reached, {min_views} are needed: "
            "change x_m, y_m or top_m in [workspace] so that the arm reaches round it, or lower min_views in [scan]. "
            f"Not reached are {told_missing(plan)}"
        )


def told_missing(plan: ViewpointPlan) -> str:
    """The viewpoints that are not reached, each with its reason, in words."""
    return "; ".join(f"{v.index}: {v.reason}" for v in plan.viewpoints if v.reason is not None)


def _home(settings: CellSettings, collisions: CollisionModel, sight: Sight) -> NDArray[np.float64]:
    if settings.arm.home_q_rad is None:
        return find_home(collisions, sight.target, sight.optics, sight.T_flange_camera)
    home = np.array(settings.arm.home_q_rad)
    short = collisions.gaps(home[None])[0] - collisions.clearances
    if short.min() < 0:
        raise ViewpointsError(
            f"home_q_rad in [arm] is not free: {collisions.contacts[short.argmin()]}, by {-short.min():.3f} m; give "
            "another, or leave it out"
        )
    return home


def _clearances_from(collisions: CollisionModel, start: NDArray[np.float64]) -> NDArray[np.float64]:
    """The clearances (C,) that hold on the way from where the arm stands."""
    gaps = collisions.gaps(start[None])[0]
    # In the workspace it may well have been at work; out of it leads any way.
    overlap = np.where(collisions.solid, -gaps, 0.0)
    if overlap.max() > OVERLAP_M:
        raise ViewpointsError(
            f"where the arm stands, {collisions.contacts[overlap.argmax()]}: they overlap by {overlap.max():.3f} m. "
            "Move it free by hand (freedrive), or correct table_z_m and obstacles_m in [mounting], body_m in [camera]"
        )
    return np.minimum(collisions.clearances, gaps - APPROACH_M)


def _coverage(viewpoints: tuple[Viewpoint, ...], sight: Sight) -> Coverage:
    optics, (low, high) = sight.optics, (sight.target + [sight.corners.min(axis=0), sight.corners.max(axis=0)])
    frustums = [
        CameraFrustum(optics.K, optics.width, optics.height, v.T_base_camera) for v in viewpoints if v.q_rad is not None
    ]
    x_m, y_m = ((float(low[axis]), float(high[axis])) for axis in range(2))
    return table_coverage(frustums, x_m, y_m, float(sight.target[2]))


def _taken(
    chosen: list[PoseChoice],
    indices: list[int],
    groups: list[NDArray[np.float64]],
    route: Route,
    start: NDArray[np.float64],
) -> tuple[tuple[Viewpoint, ...], tuple[Leg, ...]]:
    """All viewpoints, and the way by the route through those in `groups`, which have these `indices`."""
    taken = {indices[group]: groups[group][posture] for group, posture in route.stops}
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
        for index, choice in enumerate(chosen)
    )
    ends = [*(indices[group] for group, _ in route.stops), None]
    legs, place = [], start
    for view, way in zip(ends, route.ways, strict=True):
        passed = [
            q for q, before in zip(way, (place, *way), strict=False) if q is way[-1] or not np.array_equal(q, before)
        ]
        legs.append(Leg(view, np.array(passed), travel_rad(place, way)))
        place = way[-1]
    return viewpoints, tuple(legs)
