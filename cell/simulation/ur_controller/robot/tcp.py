"""Joints and tool centre point as the clients see them, computed once a cycle for all of them."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cell.kinematics import ur_kinematics
from cell.simulation.kinematic_error import KinematicError
from cell.simulation.ur_controller.robot.arm import Arm
from cell.simulation.ur_controller.robot.poses import pose_vector, twist
from cell.simulation.ur_controller.robot.trajectories import Joints

DT_S = 1e-4
"""Step of numerical derivatives."""


@dataclass(eq=False)
class _View:
    """One state of the arm, as it is sent."""

    q: Joints
    qd: Joints
    q_rad: list[float]
    qd_rad_s: list[float]
    pose: list[float] | None = None
    speed: list[float] | None = None


class Tool:
    """The tool on the flange of an arm."""

    def __init__(self, arm: Arm, error: KinematicError | None = None) -> None:
        """Create the tool.

        Args:
            arm: Arm with the flange.
            error: Error of the reported pose. None reports the pose by nominal kinematics.
        """
        self._arm, self._error = arm, error
        self._T_flange_tcp: NDArray[np.float64] | None = None
        self._last: _View | None = None

    @property
    def T_flange_tcp(self) -> NDArray[np.float64]:
        """(4, 4) pose of the tool centre point on the flange."""
        return np.eye(4) if self._T_flange_tcp is None else self._T_flange_tcp

    @T_flange_tcp.setter
    def T_flange_tcp(self, T_flange_tcp: NDArray[np.float64]) -> None:
        # None avoids the product with the identity in each cycle
        self._T_flange_tcp = None if np.array_equal(T_flange_tcp, np.eye(4)) else T_flange_tcp.copy()
        self._last = None

    @property
    def T_base_tcp(self) -> NDArray[np.float64]:
        """(4, 4) true pose of the tool centre point now."""
        T = self._arm.T_base_flange
        return T if self._T_flange_tcp is None else T @ self._T_flange_tcp

    def at(self, q: Joints) -> NDArray[np.float64]:
        """Return the pose (4, 4) of the tool centre point at joint angles (6,)."""
        T = ur_kinematics.forward(self._arm.model, q)
        return T if self._T_flange_tcp is None else T @ self._T_flange_tcp

    @property
    def q_rad(self) -> list[float]:
        """Joint angles (6,)."""
        return self._view().q_rad

    @property
    def qd_rad_s(self) -> list[float]:
        """Joint speeds (6,)."""
        return self._view().qd_rad_s

    @property
    def pose(self) -> list[float]:
        """Reported pose of the tool centre point, x, y, z and rotation vector."""
        view = self._view()
        if view.pose is None:
            view.pose = pose_vector(self._reported())
        return view.pose

    @property
    def speed(self) -> list[float]:
        """Linear and angular velocity (6,) of the tool centre point."""
        view = self._view()
        if view.speed is None:
            view.speed = [0.0] * 6
            if not self._arm.still:
                view.speed = twist(self.T_base_tcp, self.at(self._arm.q + DT_S * self._arm.qd), DT_S)
        return view.speed

    def _reported(self) -> NDArray[np.float64]:
        """Return the pose (4, 4) of the tool centre point as the controller reports it."""
        if self._error is None:
            return self.T_base_tcp
        T = self._error.apply(self._arm.T_base_flange)
        return T if self._T_flange_tcp is None else T @ self._T_flange_tcp

    def _view(self) -> _View:
        arm, view = self._arm, self._last
        if view is None or view.q is not arm.q or view.qd is not arm.qd:
            view = self._last = _View(arm.q, arm.qd, arm.q.tolist(), arm.qd.tolist())
        return view
