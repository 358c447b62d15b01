"""Selection of a pose for each viewpoint: the first candidate that is free of collisions and has a path home.

The effort of the search is limited and shared by the viewpoints, so that a cell in which nothing is reachable is also
reported soon. The limit is a number of poses, so the result does not depend on the machine.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from cell.kinematics.collision import CollisionModel
from cell.kinematics.ik_branches import OUT_OF_REACH, TOO_NEAR, find_postures, with_turns
from cell.kinematics.joint_paths import JointPaths
from cell.planning.candidate_poses import PoseToTry

MAX_POSTURES = 12
"""Number of postures of each viewpoint, nearest to home, that enter the search for the best route."""
POSES_TRIED = 4
"""Number of equally good poses that are checked for a path home."""
POSES_HELD = 100
"""Number of poses within reach that are checked for each viewpoint, on average. It is half if none is found at all."""
LIFTED_POSTURES = 2
"""Number of postures of a viewpoint without a straight path that are checked with a lifted flange, which takes long."""
NO_FREE_PATH = "no free path leads there from home, straight or by a lifted flange"


@dataclass(frozen=True, eq=False)
class PoseChoice:
    """Selected pose of a viewpoint."""

    pose: PoseToTry
    """Selected pose, or the preferred one if none is reachable."""
    postures: NDArray[np.float64]
    """Joint angles (K, 6) with a path home."""
    reason: str | None
    """Why there are none, or None."""


@dataclass(eq=False)
class _Search:
    """Search state of a viewpoint without a pose."""

    tries: Iterator[list[PoseToTry]]
    wanted: PoseToTry | None = None
    reason: str = ""
    held: list[tuple[PoseToTry, NDArray[np.float64]]] = field(default_factory=list)
    """Poses without a straight path, with their joint angles (K, 6), nearest to home first."""


def choose_poses(
    tries: Sequence[Iterator[list[PoseToTry]]],
    collisions: CollisionModel,
    paths: JointPaths,
    home: NDArray[np.float64],
) -> list[PoseChoice]:
    """Return for each viewpoint its first usable pose, or the preferred pose with the reason why none is usable.

    Poses with a straight path home are preferred to poses with a detour.

    Args:
        tries: Candidate poses of each viewpoint, as `cell.planning.candidate_poses.poses_to_try` gives them.
        collisions: Collision model of the cell.
        paths: Finder of joint paths.
        home: Joint angles (6,) of the home posture.
    """
    searches = dict(enumerate(map(_Search, tries)))
    chosen: dict[int, PoseChoice] = {}
    most, held, going_on = POSES_HELD * len(tries), 0, True
    # in turn, so that the limited effort is the same for each viewpoint
    while going_on and held < (most if chosen else most / 2):
        going_on = False
        for index, search in searches.items():
            if index in chosen or (level := next(search.tries, None)) is None:
                continue
            going_on = True
            choice, within_reach = _straight(search, level, collisions, paths, home)
            held += within_reach
            if choice is not None:
                chosen[index] = choice
    for index, search in searches.items():
        if index not in chosen:
            assert search.wanted is not None
            none = PoseChoice(search.wanted, np.zeros((0, 6)), search.reason)
            chosen[index] = _lifted(search, paths) or none
    return [chosen[index] for index in searches]


def _straight(
    search: _Search,
    level: list[PoseToTry],
    collisions: CollisionModel,
    paths: JointPaths,
    home: NDArray[np.float64],
) -> tuple[PoseChoice | None, int]:
    """Return the first pose of the level with a straight path home, and the number of poses within reach."""
    postures = find_postures(collisions, np.array([pose.T_base_flange for pose in level]))
    held = sum(reason not in (OUT_OF_REACH, TOO_NEAR) for reason in postures.reasons)
    if search.wanted is None:
        search.wanted, search.reason = level[0], postures.reasons[0] or NO_FREE_PATH
    for pose in np.unique(postures.which)[:POSES_TRIED]:
        q = with_turns(postures.of(pose), home)
        nearest = q[np.abs(q - home).max(axis=1).argsort(kind="stable")[:MAX_POSTURES]]
        direct = nearest[paths.free_each(home, nearest)]
        if len(direct):
            return PoseChoice(level[pose], direct, None), held
        search.held.append((level[pose], nearest))
        search.reason = NO_FREE_PATH
    return None, held


def _lifted(search: _Search, paths: JointPaths) -> PoseChoice | None:
    for pose, nearest in search.held[:1]:
        linked = paths.linked(nearest[:LIFTED_POSTURES])
        if len(linked):
            return PoseChoice(pose, linked, None)
    return None
