"""Joint paths between two postures: straight lines in joint space, or a detour by a third posture."""

import itertools

import numpy as np
from numpy.typing import NDArray

from cell.kinematics.collision import CollisionModel
from cell.kinematics.ik_branches import with_full_turns
from cell.kinematics.ur_kinematics import forward, inverse

STEP_RAD = 0.03
"""Sum of all joint motions between two collision checks. Half of it moves no part by more than 1.5 % of the arm's
length, which is 2 cm for the longest arm and less than the usual clearance."""
LIFT_HEIGHTS_M = (0.05, 0.10, 0.20, 0.30)
"""Heights by which the flange is lifted for a detour, tried in this order."""
MAX_LIFTED = 3
"""Number of postures of a viewpoint for which a detour is tried."""

JointPath = tuple[NDArray[np.float64], ...]
"""Joint angles (6,) of the waypoints in order, without the start."""


def travel_rad(q_from: NDArray[np.float64], path: JointPath) -> float:
    """Return the motion of the leading joint, summed over the legs of a path."""
    waypoints = [q_from, *path]
    return float(sum(np.abs(b - a).max() for a, b in itertools.pairwise(waypoints)))


class PathFinder:
    """Find collision-free paths, and keep the results of all checks."""

    def __init__(self, collisions: CollisionModel, home_q_rad: NDArray[np.float64]) -> None:
        self._collisions = collisions
        self._home = home_q_rad
        self._free: dict[bytes, bool] = {}
        self._home_paths: dict[bytes, JointPath | None] = {}

    def without_results(self) -> "PathFinder":
        """Return a finder for the same cell that has no results yet and keeps its own."""
        return PathFinder(self._collisions, self._home)

    def is_free(
        self, q_from: NDArray[np.float64], q_to: NDArray[np.float64], clearances: NDArray[np.float64] | None = None
    ) -> bool:
        """Return whether a straight line in joint space keeps the clearances.

        Args:
            q_from: Joint angles (6,) at the start.
            q_to: Joint angles (6,) at the end.
            clearances: Smallest distances (C,). None means those of the collision model.
        """
        return bool(self.are_free(q_from, q_to[None], clearances)[0])

    def are_free(
        self, q_from: NDArray[np.float64], q_to: NDArray[np.float64], clearances: NDArray[np.float64] | None = None
    ) -> NDArray[np.bool_]:
        """Return the same for the lines from one posture (6,) to each of several (N, 6), as (N,)."""
        needed = self._collisions.clearances if clearances is None else clearances
        keys = [min(line) + max(line) + needed.tobytes() for line in ((q_from.tobytes(), q.tobytes()) for q in q_to)]
        unknown = [k for k, key in enumerate(keys) if key not in self._free]
        if unknown:
            # obstacles are rarely near the ends, so a few samples find most lines that are not free
            ends = q_to[unknown]
            free = self._lines_are_free(q_from, ends, np.full(len(ends), 8), needed)
            steps = np.ceil(np.abs(ends - q_from).sum(axis=1) / STEP_RAD).astype(np.int64) + 1
            free[free] = self._lines_are_free(q_from, ends[free], steps[free], needed)
            self._free.update((keys[k], bool(is_free)) for k, is_free in zip(unknown, free, strict=True))
        return np.array([self._free[key] for key in keys], dtype=np.bool_)

    def _lines_are_free(
        self,
        q_from: NDArray[np.float64],
        ends: NDArray[np.float64],
        steps: NDArray[np.int64],
        needed: NDArray[np.float64],
    ) -> NDArray[np.bool_]:
        """Return whether each line to one of `ends` (N, 6) is free at `steps` (N,) samples and at its end."""
        line = np.repeat(np.arange(len(ends)), steps + 1)
        first = np.repeat(np.cumsum(steps + 1) - steps - 1, steps + 1)
        share = (np.arange(len(line)) - first) / steps[line]
        gaps = self._collisions.gaps(q_from + share[:, None] * (ends[line] - q_from))
        blocked = (gaps < needed).any(axis=1)
        return np.bincount(line, blocked, minlength=len(ends)) == 0

    def path_home(self, q: NDArray[np.float64], clearances: NDArray[np.float64] | None = None) -> JointPath | None:
        """Return a path home, straight or with the flange lifted, or None.

        Args:
            q: Joint angles (6,) at the start.
            clearances: Smallest distances (C,) on the first leg, as in `is_free`.
        """
        key = q.tobytes() + (b"" if clearances is None else clearances.tobytes())
        if key not in self._home_paths:
            self._home_paths[key] = self._find_path_home(q, clearances)
        return self._home_paths[key]

    def path_between(self, q_from: NDArray[np.float64], q_to: NDArray[np.float64]) -> JointPath | None:
        """Return a straight path if it is free, else one by the home posture, or None."""
        return (q_to,) if self.is_free(q_from, q_to) else self.path_via_home(self.path_home(q_from), q_to)

    def path_via_home(self, there: JointPath | None, q_to: NDArray[np.float64]) -> JointPath | None:
        """Return the path home `there`, continued to a posture, or None if either part is missing."""
        back = self.path_home(q_to)
        return None if there is None or back is None else (*there, *back[-2::-1], q_to)

    def with_path_home(self, q: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return those of the postures (N, 6) with a straight path home, else the first one with a detour."""
        direct = q[self.are_free(self._home, q)]
        if len(direct):
            return direct
        for choice in q[:MAX_LIFTED]:
            if self.path_home(choice) is not None:
                return choice[None]
        return direct

    def _find_path_home(self, q: NDArray[np.float64], clearances: NDArray[np.float64] | None) -> JointPath | None:
        if self.is_free(q, self._home, clearances):
            return (self._home,)
        T = forward(self._collisions.model, q)
        for rise in LIFT_HEIGHTS_M:
            raised = T.copy()
            raised[2, 3] += rise
            choices = with_full_turns(inverse(self._collisions.model, raised), q)
            if not len(choices):
                continue
            nearest = choices[np.abs(choices - q).max(axis=1).argmin()]
            if self.is_free(q, nearest, clearances) and self.is_free(nearest, self._home):
                return (nearest, self._home)
        return None
