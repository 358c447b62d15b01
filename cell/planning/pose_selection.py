"""Selection of a pose for each viewpoint: the first candidate that is free of collisions and has a path home.

The effort of the search is limited and shared by the viewpoints, so that a cell in which nothing is reachable is also
reported soon. The limit is a number of poses, so the result does not depend on the machine.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from cell.kinematics.collision import CollisionModel
from cell.kinematics.ik_branches import OUT_OF_REACH, TOO_NEAR, find_ik_solutions, with_full_turns
from cell.kinematics.joint_paths import PathFinder
from cell.planning.candidate_poses import CandidatePose

MAX_SOLUTIONS = 12
"""Number of postures of each viewpoint, nearest to home, that enter the search for the best tour."""
POSES_CHECKED_FOR_PATH = 4
"""Number of equally good poses that are checked for a path home."""
MAX_POSES_IN_REACH = 100
"""Number of poses within reach that are checked for each viewpoint, on average. It is half if none is found at all."""
LIFTED_SOLUTIONS = 2
"""Number of postures of a viewpoint without a straight path that are checked with a lifted flange, which takes long."""
NO_FREE_PATH = "no collision-free path leads there from home, neither directly nor with a lifted flange"


@dataclass(frozen=True, eq=False)
class PoseChoice:
    """Selected pose of a viewpoint."""

    pose: CandidatePose
    """Selected pose, or the preferred one if none is reachable."""
    postures: NDArray[np.float64]
    """Joint angles (K, 6) with a path home."""
    reason: str | None
    """Why there are none, or None."""


@dataclass(eq=False)
class _Search:
    """Search state of a viewpoint without a pose."""

    candidates: Iterator[list[CandidatePose]]
    preferred: CandidatePose | None = None
    reason: str = ""
    in_reach: list[tuple[CandidatePose, NDArray[np.float64]]] = field(default_factory=list)
    """Poses without a straight path, with their joint angles (K, 6), nearest to home first."""


def choose_poses(
    candidates: Sequence[Iterator[list[CandidatePose]]],
    collisions: CollisionModel,
    path_finder: PathFinder,
    home: NDArray[np.float64],
) -> list[PoseChoice]:
    """Return for each viewpoint its first usable pose, or the preferred pose with the reason why none is usable.

    Poses with a straight path home are preferred to poses with a detour.

    Args:
        candidates: Candidate poses of each viewpoint, as `cell.planning.candidate_poses.scan_candidates` gives them.
        collisions: Collision model of the cell.
        path_finder: Finder of joint paths.
        home: Joint angles (6,) of the home posture.
    """
    searches = dict(enumerate(map(_Search, candidates)))
    chosen: dict[int, PoseChoice] = {}
    most, in_reach, going_on = MAX_POSES_IN_REACH * len(candidates), 0, True
    # in turn, so that the limited effort is the same for each viewpoint
    while going_on and in_reach < (most if chosen else most / 2):
        going_on = False
        for index, search in searches.items():
            if index in chosen or (level := next(search.candidates, None)) is None:
                continue
            going_on = True
            choice, within_reach = _straight(search, level, collisions, path_finder, home)
            in_reach += within_reach
            if choice is not None:
                chosen[index] = choice
    for index, search in searches.items():
        if index not in chosen:
            assert search.preferred is not None
            none = PoseChoice(search.preferred, np.zeros((0, 6)), search.reason)
            chosen[index] = _lifted(search, path_finder) or none
    return [chosen[index] for index in searches]


def _straight(
    search: _Search,
    level: list[CandidatePose],
    collisions: CollisionModel,
    path_finder: PathFinder,
    home: NDArray[np.float64],
) -> tuple[PoseChoice | None, int]:
    """Return the first pose of the level with a straight path home, and the number of poses within reach."""
    solutions = find_ik_solutions(collisions, np.array([pose.T_base_flange for pose in level]))
    in_reach = sum(reason not in (OUT_OF_REACH, TOO_NEAR) for reason in solutions.reasons)
    if search.preferred is None:
        search.preferred, search.reason = level[0], solutions.reasons[0] or NO_FREE_PATH
    for pose in np.unique(solutions.which)[:POSES_CHECKED_FOR_PATH]:
        q = with_full_turns(solutions.of(pose), home)
        nearest = q[np.abs(q - home).max(axis=1).argsort(kind="stable")[:MAX_SOLUTIONS]]
        direct = nearest[path_finder.are_free(home, nearest)]
        if len(direct):
            return PoseChoice(level[pose], direct, None), in_reach
        search.in_reach.append((level[pose], nearest))
        search.reason = NO_FREE_PATH
    return None, in_reach


def _lifted(search: _Search, path_finder: PathFinder) -> PoseChoice | None:
    for pose, nearest in search.in_reach[:1]:
        usable = path_finder.with_path_home(nearest[:LIFTED_SOLUTIONS])
        if len(usable):
            return PoseChoice(pose, usable, None)
    return None
