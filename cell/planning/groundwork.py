"""The part of a plan that does not depend on the arm's posture at its start: home, poses, postures, free paths.

A cell is planned again and again with the same settings, so the groundwork of the last cells is kept.
"""

from collections.abc import Hashable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import cast

import numpy as np
from numpy.typing import NDArray

from cell.config.cell_config import CellSettings
from cell.kinematics.collision import CollisionModel, collision_model
from cell.kinematics.joint_paths import PathFinder
from cell.planning.candidate_poses import CandidatePose, ViewTarget, scan_candidates
from cell.planning.home import planned_home
from cell.planning.pose_selection import PoseChoice, choose_poses
from cell.planning.tour_costs import Postures

CELLS_KEPT = 4
"""Number of cells whose groundwork is kept, a few megabytes each."""


@dataclass(frozen=True, eq=False)
class Groundwork:
    """What a plan from any start is made of. Its arrays are read-only, because the plans share them."""

    view_target: ViewTarget
    """Target and camera."""
    collisions: CollisionModel
    """Collision model of the cell."""
    chosen: list[PoseChoice]
    """Chosen pose of each viewpoint."""
    indices: list[int]
    """Indices of the reachable viewpoints."""
    postures: Postures
    """Postures of the reachable viewpoints, which are numbered as in `indices`, and home."""


def scan_groundwork(settings: CellSettings, T_flange_camera: NDArray[np.float64]) -> Groundwork:
    """Return the groundwork of a scan's plans.

    Args:
        settings: Settings of the cell.
        T_flange_camera: Camera pose on the flange (4, 4).

    Raises:
        ViewpointsError: No home posture is free.
    """
    # frozen settings have a hash, which the type checker does not see
    return _kept_groundwork(cast("Hashable", settings), np.asarray(T_flange_camera, dtype=np.float64).tobytes())


@lru_cache(maxsize=CELLS_KEPT)
def _kept_groundwork(settings: CellSettings, T_flange_camera: bytes) -> Groundwork:
    view_target = ViewTarget.of(settings, settings.camera.optics, np.frombuffer(T_flange_camera).reshape(4, 4))
    return groundwork_through(settings, view_target, scan_candidates(view_target, settings.scan.viewpoints))


def groundwork_through(
    settings: CellSettings, view_target: ViewTarget, candidates: Sequence[Iterator[list[CandidatePose]]]
) -> Groundwork:
    """Return the groundwork of plans through any viewpoints.

    Args:
        settings: Settings of the cell.
        view_target: Target and camera.
        candidates: Candidate poses of each viewpoint.

    Raises:
        ViewpointsError: No home posture is free.
    """
    collisions = collision_model(settings, view_target.T_flange_camera)
    home = planned_home(settings, collisions, view_target)
    path_finder = PathFinder(collisions, home)
    chosen = choose_poses(candidates, collisions, path_finder, home)
    indices = [index for index, choice in enumerate(chosen) if choice.reason is None]
    postures = Postures.of(settings.arm, home, [chosen[index].postures for index in indices], path_finder)
    for choice in chosen:
        for array in (home, choice.postures, choice.pose.T_base_camera, choice.pose.T_base_flange):
            array.flags.writeable = False
    return Groundwork(view_target, collisions, chosen, indices, postures)
