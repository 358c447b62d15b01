"""Which pose is taken for each viewpoint: the first that the arm can hold freely and come home from.

What the search may cost is bounded, and shared by the viewpoints: where all stands in the arm's way, the answer that
nothing can be reached must not take long either. The same cell gives the same answer, on any machine.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from cell.kinematics.collision import CollisionModel
from cell.kinematics.ik_branches import OUT_OF_REACH, TOO_NEAR, find_postures, with_turns
from cell.kinematics.joint_paths import JointPaths
from cell.planning.candidate_poses import PoseToTry

MOST_POSTURES = 12
"""Of each viewpoint so many enter the search for the best route: those nearest to home."""
POSES_TRIED = 4
"""Of the poses that are equally good so many are looked at for a way home."""
POSES_HELD = 100
"""So many poses within the arm's reach are looked at for each viewpoint, on average; half as many where not one is
found for any."""
LIFTED_POSTURES = 2
"""Of a viewpoint to which no straight way leads so many postures are tried with a lifted flange: that takes long."""
NO_FREE_WAY = "no free way leads there from home, straight or by a lifted flange"


@dataclass(frozen=True, eq=False)
class PoseChoice:
    """A viewpoint's pose."""

    pose: PoseToTry
    postures: NDArray[np.float64]
    """(K, 6), from each of which a way leads home."""
    reason: str | None
    """Why there are none."""


@dataclass(eq=False)
class _Search:
    """A viewpoint for which no pose was found yet."""

    tries: Iterator[list[PoseToTry]]
    wanted: PoseToTry | None = None
    reason: str = ""
    held: list[tuple[PoseToTry, NDArray[np.float64]]] = field(default_factory=list)
    """Poses to which no straight way leads, and their postures (K, 6), the nearest to home first."""


def choose_poses(
    tries: Sequence[Iterator[list[PoseToTry]]],
    collisions: CollisionModel,
    paths: JointPaths,
    home: NDArray[np.float64],
) -> list[PoseChoice]:
    """For each viewpoint the first pose that will do; the wanted one, and why not, where none does.

    `tries` are as of `cell.planning.candidate_poses.poses_to_try`. Poses with a straight way home come before those
    with another.
    """
    searches = dict(enumerate(map(_Search, tries)))
    chosen: dict[int, PoseChoice] = {}
    most, held, going_on = POSES_HELD * len(tries), 0, True
    # In turn: if the search has to end, it has gone as far for one viewpoint as for another.
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
    """The first pose of the level with a straight way home, and how many poses are within reach."""
    postures = find_postures(collisions, np.array([pose.T_base_flange for pose in level]))
    held = sum(reason not in (OUT_OF_REACH, TOO_NEAR) for reason in postures.reasons)
    if search.wanted is None:
        search.wanted, search.reason = level[0], postures.reasons[0] or NO_FREE_WAY
    for pose in np.unique(postures.which)[:POSES_TRIED]:
        q = with_turns(postures.of(pose), home)
        nearest = q[np.abs(q - home).max(axis=1).argsort(kind="stable")[:MOST_POSTURES]]
        direct = nearest[paths.free_each(home, nearest)]
        if len(direct):
            return PoseChoice(level[pose], direct, None), held
        search.held.append((level[pose], nearest))
        search.reason = NO_FREE_WAY
    return None, held


def _lifted(search: _Search, paths: JointPaths) -> PoseChoice | None:
    for pose, nearest in search.held[:1]:
        linked = paths.linked(nearest[:LIFTED_POSTURES])
        if len(linked):
            return PoseChoice(pose, linked, None)
    return None
