"""Mechanics of the simulated arm: joint positions by the clock."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cell.config.arm_models import ArmModelName
from cell.kinematics import ur_kinematics
from cell.simulation.ur_controller.robot.event_log import EventLog
from cell.simulation.ur_controller.robot.trajectories import REST, Braking, Joints, Motion

HANDOVER_RAD_S2 = 15.0
"""Deceleration of the leading joint when a new move replaces the current one, and when a program ends or pauses."""
PROTECTIVE_RAD_S2 = 25.0
"""Deceleration of a stop by the safety system. Real arms stop in about 0.1 s from usual speeds."""


class UnreachableGoalError(ValueError):
    """The arm cannot reach the target."""


@dataclass(frozen=True)
class Goal:
    """Target of a move."""

    kind: str
    """Kind of the move, for example "movej"."""
    plan: Callable[[Joints], Motion]
    """Returns the motion from the given joint angles. It raises UnreachableGoalError."""
    details: dict[str, Any] = field(default_factory=dict)
    """Details for the log."""


class Arm:
    """Joints that move by the clock. The rate of `advance` affects only when the state is seen."""

    def __init__(self, model: ArmModelName, q_rad: Joints, time_factor: float, log: EventLog, now_s: float) -> None:
        self.model: ArmModelName = model
        self.q, self.qd = q_rad, REST
        self.speed_fraction = 1.0
        """Speed slider, which scales moves and not stops."""
        self._factor, self._log, self._now_s = time_factor, log, now_s
        self._goal: Goal | None = None
        self._motion: Motion | None = None
        self._braking = False
        self._t_s = 0.0
        self._flange: tuple[Joints, NDArray[np.float64]] | None = None

    @property
    def busy(self) -> bool:
        """Whether the arm moves, or has a target."""
        return self._goal is not None or self._motion is not None

    @property
    def still(self) -> bool:
        """Whether all joints stand still."""
        return self._motion is None

    @property
    def progress(self) -> float:
        """Completed share of the current move by time, 0 to 1, or 0 without a move."""
        if self._motion is None or self._braking or self._motion.duration_s <= 0:
            return 0.0
        return min(1.0, self._t_s / self._motion.duration_s)

    def moment_of(self, share: float) -> float | None:
        """Return the time at which a share of the current move is completed at the present speed, or now if it is."""
        rate = self._factor * self.speed_fraction
        if self._motion is None or self._braking or rate <= 0:
            return None
        return self._now_s + max(0.0, share * self._motion.duration_s - self._t_s) / rate

    @property
    def T_base_flange(self) -> NDArray[np.float64]:
        """(4, 4) flange pose now."""
        if self._flange is None or self._flange[0] is not self.q:
            self._flange = self.q, ur_kinematics.forward(self.model, self.q)
        return self._flange[1]

    def go(self, goal: Goal) -> None:
        """Move to the target.

        A current move is stopped first. Raise UnreachableGoalError if the target is out of reach.
        """
        if self._motion is not None and not self._braking:
            self._brake(HANDOVER_RAD_S2, "replaced")
        self._goal = goal
        if self._motion is None:
            self._begin(goal)

    def brake(self, deceleration_rad_s2: float, reason: str) -> None:
        """Stop, and drop the target."""
        self._goal = None
        self._brake(deceleration_rad_s2, reason)

    def brake_tool(self, deceleration_m_s2: float, reason: str) -> None:
        """Stop with a given deceleration of the tool, and drop the target."""
        speed = float(np.linalg.norm((ur_kinematics.jacobian(self.model, self.q) @ self.qd)[:3]))
        leading = float(np.abs(self.qd).max())
        # a tool that only rotates has no linear speed
        self.brake(leading * deceleration_m_s2 / speed if speed > 1e-3 * leading else HANDOVER_RAD_S2, reason)

    def pause(self, deceleration_rad_s2: float, reason: str) -> Goal | None:
        """Stop, and return the target so that the move can continue."""
        goal = self._goal
        self.brake(deceleration_rad_s2, reason)
        return goal

    def place(self, q_rad: Joints) -> None:
        """Put the arm to other joint angles, at rest."""
        self.q, self.qd, self._goal, self._motion, self._braking = q_rad, REST, None, None, False

    def advance(self, now_s: float) -> None:
        """Move the joints to their state at `now_s`."""
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
        # in the arm's own time, so that a stop of 0.2 s takes 0.2 s / factor at any slider position
        qd = self.qd / self._factor
        duration_s = float(np.abs(qd).max()) / max(deceleration_rad_s2, 1e-3)
        if self._braking and self._motion.duration_s - self._t_s <= duration_s:
            return  # a stop never makes a running stop slower
        self._motion, self._t_s, self._braking = Braking(self.q, qd, duration_s), 0.0, True
        self._log.add("braking", self._now_s, reason=reason, q_rad=self.q.tolist(), duration_s=duration_s)
