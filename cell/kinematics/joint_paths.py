"""Ways from one posture of the arm to another: straight lines in joint space, and round a hindrance by a third one."""

import itertools

import numpy as np
from numpy.typing import NDArray

from cell.kinematics.collision import CollisionModel
from cell.kinematics.ik_branches import with_turns
from cell.kinematics.ur_kinematics import forward, inverse

STEP_RAD = 0.03
"""Turn of all joints together between two postures that are looked at. In half of it nothing moves further than 1.5 %
of the arm's length, 2 cm of the longest arm: less than the usual clearance."""
RISES_M = (0.05, 0.10, 0.20, 0.30)
"""The flange is lifted so far for a posture on the way."""
LIFTED_CHOICES = 3
"""Of the postures for a viewpoint so many are tried with that."""

Way = tuple[NDArray[np.float64], ...]
"""Postures (6,) to pass one after another, without the first."""


def travel_rad(q_from: NDArray[np.float64], way: Way) -> float:
    """The leading joint's turns along a way, together."""
    places = [q_from, *way]
    return float(sum(np.abs(b - a).max() for a, b in itertools.pairwise(places)))


class JointPaths:
    """Looks for free ways, remembering what it has looked at."""

    def __init__(self, collisions: CollisionModel, home_q_rad: NDArray[np.float64]) -> None:
        self._collisions = collisions
        self._home = home_q_rad
        self._free: dict[bytes, bool] = {}
        self._home_ways: dict[bytes, Way | None] = {}

    def free(
        self, q_from: NDArray[np.float64], q_to: NDArray[np.float64], clearances: NDArray[np.float64] | None = None
    ) -> bool:
        """Whether the straight line keeps the clearances: the model's own, or others (C,)."""
        return bool(self.free_each(q_from, q_to[None], clearances)[0])

    def free_each(
        self, q_from: NDArray[np.float64], q_to: NDArray[np.float64], clearances: NDArray[np.float64] | None = None
    ) -> NDArray[np.bool_]:
        """The same for the lines from one posture (6,) to each of others (N, 6): (N,)."""
        needed = self._collisions.clearances if clearances is None else clearances
        keys = [min(line) + max(line) + needed.tobytes() for line in ((q_from.tobytes(), q.tobytes()) for q in q_to)]
        unknown = [k for k, key in enumerate(keys) if key not in self._free]
        if unknown:
            # What hinders is seldom near the ends: a few places between tell most lines that are not free.
            ends = q_to[unknown]
            free = self._clear(q_from, ends, np.full(len(ends), 8), needed)
            steps = np.ceil(np.abs(ends - q_from).sum(axis=1) / STEP_RAD).astype(np.int64) + 1
            free[free] = self._clear(q_from, ends[free], steps[free], needed)
            self._free.update((keys[k], bool(is_free)) for k, is_free in zip(unknown, free, strict=True))
        return np.array([self._free[key] for key in keys], dtype=np.bool_)

    def _clear(
        self,
        q_from: NDArray[np.float64],
        ends: NDArray[np.float64],
        steps: NDArray[np.int64],
        needed: NDArray[np.float64],
    ) -> NDArray[np.bool_]:
        """Whether each line to one of `ends` (N, 6) is clear at so many places and its end."""
        line = np.repeat(np.arange(len(ends)), steps + 1)
        first = np.repeat(np.cumsum(steps + 1) - steps - 1, steps + 1)
        share = (np.arange(len(line)) - first) / steps[line]
        gaps = self._collisions.gaps(q_from + share[:, None] * (ends[line] - q_from))
        blocked = (gaps < needed).any(axis=1)
        return np.bincount(line, blocked, minlength=len(ends)) == 0

    def way_home(self, q: NDArray[np.float64], clearances: NDArray[np.float64] | None = None) -> Way | None:
        """From a posture home, straight or by a posture in which the flange is lifted; None where neither is free.

        `clearances` hold for the first straight piece, as in `free`.
        """
        key = q.tobytes() + (b"" if clearances is None else clearances.tobytes())
        if key not in self._home_ways:
            self._home_ways[key] = self._find_way_home(q, clearances)
        return self._home_ways[key]

    def way(self, q_from: NDArray[np.float64], q_to: NDArray[np.float64]) -> Way | None:
        """Straight if that is free, else by home; None where neither is."""
        return (q_to,) if self.free(q_from, q_to) else self.by_home(self.way_home(q_from), q_to)

    def by_home(self, there: Way | None, q_to: NDArray[np.float64]) -> Way | None:
        """The way home `there` and on to a posture; None where either has none."""
        back = self.way_home(q_to)
        return None if there is None or back is None else (*there, *back[-2::-1], q_to)

    def linked(self, q: NDArray[np.float64]) -> NDArray[np.float64]:
        """Those of the postures (N, 6) from which a straight line leads home; else the first with another way."""
        direct = q[self.free_each(self._home, q)]
        if len(direct):
            return direct
        for choice in q[:LIFTED_CHOICES]:
            if self.way_home(choice) is not None:
                return choice[None]
        return direct

    def _find_way_home(self, q: NDArray[np.float64], clearances: NDArray[np.float64] | None) -> Way | None:
        if self.free(q, self._home, clearances):
            return (self._home,)
        T = forward(self._collisions.model, q)
        for rise in RISES_M:
            raised = T.copy()
            raised[2, 3] += rise
            choices = with_turns(inverse(self._collisions.model, raised), q)
            if not len(choices):
                continue
            nearest = choices[np.abs(choices - q).max(axis=1).argmin()]
            if self.free(q, nearest, clearances) and self.free(nearest, self._home):
                return (nearest, self._home)
        return None
