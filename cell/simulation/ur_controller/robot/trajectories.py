"""Motions of the joints over time, as pure functions of the seconds since their start.

The time is the arm's own time. It stands still at speed slider 0, and runs faster with the time factor of the
simulation.
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
        """Time after which the arm is at rest."""
        ...

    def at(self, t_s: float) -> tuple[Joints, Joints]:
        """Return joint angles (6,) and speeds (6,) at a time."""
        ...


@dataclass(frozen=True)
class Trapezoid:
    """A path of a given length with constant acceleration, speed and deceleration.

    A short path has no constant speed.
    """

    length: float
    speed: float
    acceleration: float

    @cached_property
    def ramp_s(self) -> float:
        """Duration of the acceleration, and of the deceleration."""
        return min(self.speed / self.acceleration, float(np.sqrt(self.length / self.acceleration)))

    @cached_property
    def duration_s(self) -> float:
        """Duration from rest to rest."""
        return self.ramp_s + self.length / (self.acceleration * self.ramp_s) if self.length > 0 else 0.0

    def at(self, t_s: float) -> tuple[float, float]:
        """Return the covered distance and the speed at a time."""
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
    """A straight line in joint space with synchronous joints.

    The leading joint has the given speed and acceleration.
    """

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
        """Duration from rest to rest."""
        return self._way.duration_s

    def at(self, t_s: float) -> tuple[Joints, Joints]:
        """Return joint angles (6,) and speeds (6,) at a time."""
        if t_s >= self._way.duration_s:
            return self.q_to, REST
        done, speed = self._way.at(t_s)
        return self.q_from + done * self._line, speed * self._line


@dataclass(frozen=True, eq=False)
class LineMove:
    """Motion along joint angles (N, 6), which are equal steps of a straight tool path."""

    q_steps: NDArray[np.float64]
    length_m: float
    speed_m_s: float
    acceleration_m_s2: float

    @cached_property
    def _way(self) -> Trapezoid:
        return Trapezoid(self.length_m, self.speed_m_s, self.acceleration_m_s2)

    @property
    def duration_s(self) -> float:
        """Duration from rest to rest."""
        return self._way.duration_s

    def at(self, t_s: float) -> tuple[Joints, Joints]:
        """Return joint angles (6,) and speeds (6,) at a time."""
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
    """Braking from the present speed to rest along the joint line, with constant deceleration."""

    q_from: Joints
    qd_from: Joints
    duration_s: float

    def at(self, t_s: float) -> tuple[Joints, Joints]:
        """Return joint angles (6,) and speeds (6,) at a time."""
        t = min(t_s, self.duration_s)
        if self.duration_s <= 0:
            return self.q_from, REST
        q = self.q_from + self.qd_from * (t - 0.5 * t**2 / self.duration_s)
        return q, self.qd_from * (1.0 - t / self.duration_s) if t < self.duration_s else REST
