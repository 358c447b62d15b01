"""Motions of the joints in time: pure functions of the seconds since they began.

Time here is the arm's own: it stands still at speed slider 0 and runs faster with the simulation's time factor.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Joints = NDArray[np.float64]

REST: Joints = np.zeros(6)
REST.flags.writeable = False


class Motion(Protocol):
    """Joint angles over time."""

    @property
    def duration_s(self) -> float:
        """After which it is at rest."""
        ...

    def at(self, t_s: float) -> tuple[Joints, Joints]:
        """Angles (6,) in radians and speeds (6,) in rad/s."""
        ...


@dataclass(frozen=True)
class Trapezoid:
    """A path of a given length with constant acceleration, speed and deceleration; a triangle if it is short."""

    length: float
    speed: float
    acceleration: float

    @cached_property
    def ramp_s(self) -> float:
        """How long it speeds up, and how long it slows down."""
        return min(self.speed / self.acceleration, float(np.sqrt(self.length / self.acceleration)))

    @cached_property
    def duration_s(self) -> float:
        """From rest to rest."""
        return self.ramp_s + self.length / (self.acceleration * self.ramp_s) if self.length > 0 else 0.0

    def at(self, t_s: float) -> tuple[float, float]:
        """Way done and speed."""
        ramp, left = self.ramp_s, self.duration_s - t_s
        if left <= 0:
            return self.length, 0.0
        if left < ramp:
            return self.length - 0.5 * self.acceleration * left**2, self.acceleration * left
        if t_s < ramp:
            return 0.5 * self.acceleration * t_s**2, self.acceleration * t_s
        return self.acceleration * ramp * (t_s - 0.5 * ramp), self.acceleration * ramp


@dataclass(frozen=True, eq=False)
class JointMove:
    """Straight from one joint vector to another, all joints in step; the leading one keeps speed and acceleration."""

    q_from: Joints
    q_to: Joints
    speed_rad_s: float
    acceleration_rad_s2: float

    @cached_property
    def _way(self) -> Trapezoid:
        return Trapezoid(float(np.abs(self.q_to - self.q_from).max()), self.speed_rad_s, self.acceleration_rad_s2)

    @cached_property
    def _line(self) -> Joints:
        return (self.q_to - self.q_from) / self._way.length if self._way.length > 0 else REST

    @property
    def duration_s(self) -> float:
        """From rest to rest."""
        return self._way.duration_s

    def at(self, t_s: float) -> tuple[Joints, Joints]:
        """Angles (6,) in radians and speeds (6,) in rad/s."""
        if t_s >= self._way.duration_s:
            return self.q_to, REST
        done, speed = self._way.at(t_s)
        return self.q_from + done * self._line, speed * self._line


@dataclass(frozen=True, eq=False)
class LineMove:
    """Along joint vectors (N, 6) that stand for equal steps of a straight line of the tool."""

    q_steps: NDArray[np.float64]
    length_m: float
    speed_m_s: float
    acceleration_m_s2: float

    @cached_property
    def _way(self) -> Trapezoid:
        return Trapezoid(self.length_m, self.speed_m_s, self.acceleration_m_s2)

    @property
    def duration_s(self) -> float:
        """From rest to rest."""
        return self._way.duration_s

    def at(self, t_s: float) -> tuple[Joints, Joints]:
        """Angles (6,) in radians and speeds (6,) in rad/s."""
        last = len(self.q_steps) - 1
        done, speed = self._way.at(t_s)
        if t_s >= self._way.duration_s or last < 1:
            return self.q_steps[-1], REST
        step = done / self.length_m * last
        k = min(int(step), last - 1)
        slope = self.q_steps[k + 1] - self.q_steps[k]
        return self.q_steps[k] + (step - k) * slope, slope * (speed * last / self.length_m)


@dataclass(frozen=True, eq=False)
class Braking:
    """From the present speed to rest along the joint line, with constant deceleration."""

    q_from: Joints
    qd_from: Joints
    duration_s: float

    def at(self, t_s: float) -> tuple[Joints, Joints]:
        """Angles (6,) in radians and speeds (6,) in rad/s."""
        t = min(t_s, self.duration_s)
        if self.duration_s <= 0:
            return self.q_from, REST
        q = self.q_from + self.qd_from * (t - 0.5 * t**2 / self.duration_s)
        return q, self.qd_from * (1.0 - t / self.duration_s) if t < self.duration_s else REST
