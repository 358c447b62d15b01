"""The simulated arm's mechanics: where the joints are, by the clock."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cell.config.arm_config import ArmModelName
from cell.kinematics import ur_kinematics
from cell.simulation.ur_controller.robot.event_log import EventLog
from cell.simulation.ur_controller.robot.trajectories import REST, Braking, Joints, Motion

HANDOVER_RAD_S2 = 15.0
"""Deceleration of the leading joint where a new move replaces one under way, and where a program ends or pauses."""
PROTECTIVE_RAD_S2 = 25.0
"""The same when the safety system stops the arm. Real arms stop in about 0.1 s from a usual speed."""


class UnreachableGoalError(ValueError):
    """The arm can't get to where it was sent."""


@dataclass(frozen=True)
class Goal:
    """Where a move shall end."""

    kind: str
    """As "movej"."""
    plan: Callable[[Joints], Motion]
    """The motion from the given joint angles. Raises UnreachableGoalError."""
    details: dict[str, Any] = field(default_factory=dict)
    """For the log."""


class Arm:
    """Joints that move by the clock: how often `advance` is called changes nothing but the moments of looking."""

    def __init__(self, model: ArmModelName, q_rad: Joints, time_factor: float, log: EventLog, now_s: float) -> None:
        self.model: ArmModelName = model
        self.q, self.qd = q_rad, REST
        self.speed_fraction = 1.0
        """The speed slider; scales moves, not stops."""
        self._factor, self._log, self._now_s = time_factor, log, now_s
        self._goal: Goal | None = None
        self._motion: Motion | None = None
        self._braking = False
        self._t_s = 0.0
        self._flange: tuple[Joints, NDArray[np.float64]] | None = None

    @property
    def busy(self) -> bool:
        """It moves, or has somewhere to go."""
        return self._goal is not None or self._motion is not None

    @property
    def still(self) -> bool:
        """No joint turns."""
        return self._motion is None

    @property
    def progress(self) -> float:
        """Which share of the move under way is done, 0 to 1, by time; 0 if there is none."""
        if self._motion is None or self._braking or self._motion.duration_s <= 0:
            return 0.0
        return min(1.0, self._t_s / self._motion.duration_s)

    def moment_of(self, share: float) -> float | None:
        """When that share of the move under way will be done (now, if it is), at the present speed setting."""
        rate = self._factor * self.speed_fraction
        if self._motion is None or self._braking or rate <= 0:
            return None
        return self._now_s + max(0.0, share * self._motion.duration_s - self._t_s) / rate

    @property
    def T_base_flange(self) -> NDArray[np.float64]:
        """The flange's pose now."""
        if self._flange is None or self._flange[0] is not self.q:
            self._flange = self.q, ur_kinematics.forward(self.model, self.q)
        return self._flange[1]

    def go(self, goal: Goal) -> None:
        """Moves to the goal; a move under way is stopped first. Raises UnreachableGoalError."""
        if self._motion is not None and not self._braking:
            self._brake(HANDOVER_RAD_S2, "replaced")
        self._goal = goal
        if self._motion is None:
            self._begin(goal)

    def brake(self, deceleration_rad_s2: float, reason: str) -> None:
        """Stops, and forgets where it was going."""
        self._goal = None
        self._brake(deceleration_rad_s2, reason)

    def brake_tool(self, deceleration_m_s2: float, reason: str) -> None:
        """Stops with the tool's deceleration given, and forgets where it was going."""
        speed = float(np.linalg.norm((ur_kinematics.jacobian(self.model, self.q) @ self.qd)[:3]))
        leading = float(np.abs(self.qd).max())
        # A tool that only turns on the spot has no speed to go by.
        self.brake(leading * deceleration_m_s2 / speed if speed > 1e-3 * leading else HANDOVER_RAD_S2, reason)

    def pause(self, deceleration_rad_s2: float, reason: str) -> Goal | None:
        """Stops; gives where it was going, so that it can be sent on."""
        goal = self._goal
        self.brake(deceleration_rad_s2, reason)
        return goal

    def place(self, q_rad: Joints) -> None:
        """Puts it somewhere else, at rest."""
        self.q, self.qd, self._goal, self._motion, self._braking = q_rad, REST, None, None, False

    def advance(self, now_s: float) -> None:
        """Brings the joints to where they are at `now_s`."""
        left_s = max(0.0, now_s - self._now_s)
        self._now_s = max(now_s, self._now_s)
        while self._motion is not None:
            rate = self._factor * (1.0 if self._braking else self.speed_fraction)
            due_s = self._motion.duration_s - self._t_s
            if left_s * rate < due_s:
                self._t_s += left_s * rate
                self.q, qd = self._motion.at(self._t_s)
                self.qd = rate * qd
                return
            left_s -= due_s / rate if rate > 0 else 0.0
            self._end(self._now_s - left_s)

    def _end(self, stamp_s: float) -> None:
        assert self._motion is not None
        self.q, self.qd = self._motion.at(self._motion.duration_s)[0], REST
        self._log.add("still" if self._braking else "motion_done", stamp_s, q_rad=self.q.tolist())
        goal = self._goal if self._braking else None
        self._goal, self._motion, self._braking = goal, None, False
        if goal is not None:
            self._begin(goal, stamp_s)

    def _begin(self, goal: Goal, stamp_s: float | None = None) -> None:
        try:
            self._motion = goal.plan(self.q)
        except UnreachableGoalError:
            self._goal = None
            raise
        self._t_s, self._braking = 0.0, False
        self._log.add(
            "motion_start",
            self._now_s if stamp_s is None else stamp_s,
            move=goal.kind,
            q_from_rad=self.q.tolist(),
            duration_s=self._motion.duration_s,
            **goal.details,
        )

    def _brake(self, deceleration_rad_s2: float, reason: str) -> None:
        if self._motion is None:
            return
        # In the arm's own time: what stops in 0.2 s stops in 0.2 s / factor, whatever the slider was.
        qd = self.qd / self._factor
        duration_s = float(np.abs(qd).max()) / max(deceleration_rad_s2, 1e-3)
        if self._braking and self._motion.duration_s - self._t_s <= duration_s:
            return  # a stop never makes a stop gentler
        self._motion, self._t_s, self._braking = Braking(self.q, qd, duration_s), 0.0, True
        self._log.add("braking", self._now_s, reason=reason, q_rad=self.q.tolist(), duration_s=duration_s)
