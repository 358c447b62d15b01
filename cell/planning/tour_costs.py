"""Durations of the moves between the postures of a tour, seconds."""

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cell.config.arm_config import ArmSettings
from cell.kinematics.joint_paths import JointPath, PathFinder
from cell.kinematics.move_duration import move_durations, path_duration

EARLY_SHARE = 0.9
"""Expected share of the scans that end after the viewpoints visited first. In a study with simulated scenes, four views
were enough for 98 % of the easy scenes and for 60 to 80 % of the hard ones."""


@dataclass(frozen=True, eq=False)
class Postures:
    """Postures of the viewpoints, with what is known about the moves between them. The arm's start is no part of it."""

    arm: ArmSettings
    """Model, speeds and acceleration of the arm."""
    home_q_rad: NDArray[np.float64]
    """Joint angles (6,) of the home posture, to which a path leads from each posture."""
    q_rad: NDArray[np.float64]
    """Joint angles (N, 6) of all postures."""
    group: NDArray[np.int64]
    """Viewpoint (N,) of each posture, ascending."""
    between_s: NDArray[np.float64]
    """Durations (N, N) of the straight moves between postures of different viewpoints, otherwise infinite."""
    to_home_s: NDArray[np.float64]
    """Durations (N,) of the straight moves home."""
    path_finder: PathFinder
    """Finder of the paths between the postures and home. It keeps its results."""

    @staticmethod
    def of(
        arm: ArmSettings, home_q_rad: NDArray[np.float64], groups: list[NDArray[np.float64]], path_finder: PathFinder
    ) -> "Postures":
        """Return the postures of some viewpoints.

        Args:
            arm: Model, speeds and acceleration of the arm.
            home_q_rad: Joint angles (6,) of the home posture.
            groups: Joint angles (K, 6) of the postures of each viewpoint, one of which is visited.
            path_finder: Finder of joint paths.
        """
        q = np.concatenate([np.zeros((0, 6)), *groups])
        group = np.repeat(np.arange(len(groups)), [len(g) for g in groups])
        # a move takes as long as its reverse
        one, other = np.nonzero(group[:, None] < group)
        between = np.full((len(q), len(q)), np.inf)
        between[one, other] = between[other, one] = move_durations(arm, q[one], q[other])
        return Postures(arm, home_q_rad, q, group, between, move_durations(arm, q, home_q_rad), path_finder)


class TourCosts:
    """Durations of the moves, as far as known. A straight line counts as free until it is checked."""

    def __init__(self, postures: Postures, start: NDArray[np.float64], start_clearances: NDArray[np.float64]) -> None:
        self.q, self.group = postures.q_rad, postures.group
        self.between, self.to_home = postures.between_s.copy(), postures.to_home_s.copy()
        self.from_start = move_durations(postures.arm, start, self.q)
        self._arm, self._path_finder = postures.arm, postures.path_finder
        self._start, self._start_clearances = start, start_clearances
        # the postures' finder is kept for other starts, so it does not collect the lines from this one
        self._start_finder = postures.path_finder.without_results()
        if self.home_path_of_start() is None:
            self.from_start[~self._start_finder.are_free(start, self.q, start_clearances)] = np.inf

    def home_path_of_start(self) -> JointPath | None:
        """Return the path from the start home, or None."""
        return self._start_finder.path_home(self._start, self._start_clearances)

    def start_path(self, node: int) -> JointPath | None:
        """Return the path from the start to a posture, or None."""
        if self._start_finder.is_free(self._start, self.q[node], self._start_clearances):
            return (self.q[node],)
        return self._path_finder.path_via_home(self.home_path_of_start(), self.q[node])

    def path_between(self, a: int, b: int) -> JointPath | None:
        """Return the path between two postures, or None."""
        return self._path_finder.path_between(self.q[a], self.q[b])

    def home_path(self, node: int) -> JointPath | None:
        """Return the path from a posture home, or None."""
        return self._path_finder.path_home(self.q[node])

    def check_lines(self, nodes: list[int], first: int) -> bool:
        """Check the lines of a tour and correct their durations. Return whether the tour takes no longer than before.

        Args:
            nodes: Postures in order.
            first: Number of postures after which the tour may end, as in `expected_s`.
        """
        before = self.expected_s(nodes, first)
        self.from_start[nodes[0]] = self._duration(self._start, self.start_path(nodes[0]))
        for a, b in itertools.pairwise(nodes):
            self.between[a, b] = self.between[b, a] = self._duration(self.q[a], self.path_between(a, b))
        for node in {nodes[first - 1], nodes[-1]}:
            self.to_home[node] = self._duration(self.q[node], self.home_path(node))
        return self.expected_s(nodes, first) <= before + 1e-9

    def expected_s(self, nodes: list[int], first: int) -> float:
        """Return the expected duration of a tour and the way home, seconds.

        Args:
            nodes: Postures in order.
            first: Number of postures after which `EARLY_SHARE` of the tours end. 0 means that none ends early.
        """
        whole = self._tour_s(nodes)
        return EARLY_SHARE * self._tour_s(nodes[:first]) + (1 - EARLY_SHARE) * whole if first else whole

    def _tour_s(self, nodes: list[int]) -> float:
        inner = sum(self.between[a, b] for a, b in itertools.pairwise(nodes))
        return float(self.from_start[nodes[0]] + inner + self.to_home[nodes[-1]])

    def _duration(self, q_from: NDArray[np.float64], path: JointPath | None) -> float:
        return np.inf if path is None else path_duration(self._arm, q_from, path)
