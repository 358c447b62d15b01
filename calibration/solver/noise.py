"""Noise levels and priors of the calibration."""

from dataclasses import astuple, dataclass, replace

import numpy as np
from numpy.typing import NDArray

SMOOTH_START_M = 5e-4
"""Smooth position error per axis at which the estimate begins, metres: that of an arm without its own calibration."""
SMOOTH_START_RAD = float(np.radians(0.1))
"""Smooth rotation error per axis at which the estimate begins, radians: that of an arm without its own calibration."""


@dataclass(frozen=True)
class NoiseLevel:
    """Standard deviations of the measurement noise per axis."""

    pixel_px: float
    """Corner noise per image coordinate, pixels."""
    robot_m: float
    """Position error of the reported flange pose per axis, metres."""
    robot_rad: float
    """Rotation error of the reported flange pose per axis, radians."""
    smooth_m: float
    """Position error per axis that changes smoothly with the flange pose, metres."""
    smooth_rad: float
    """Rotation error per axis that changes smoothly with the flange pose, radians."""

    def smooth_sigmas(self, count: int) -> NDArray[np.float64]:
        """Return the standard deviations of `count` weights of the smooth robot errors."""
        return np.tile([self.smooth_rad] * 3 + [self.smooth_m] * 3, count // 6)

    @property
    def robot(self) -> NDArray[np.float64]:
        """(6,) standard deviations of a robot error: rotation (rad), then translation (m)."""
        return np.array([self.robot_rad] * 3 + [self.robot_m] * 3)

    def is_close(self, other: "NoiseLevel", relative_tolerance: float) -> bool:
        """Return whether each level equals the same level of `other` within `relative_tolerance`."""
        return np.allclose(astuple(self), astuple(other), rtol=relative_tolerance, atol=0.0)


@dataclass(frozen=True)
class NoisePriors:
    """Prior standard deviations of noise, lens and board scale.

    The noise levels of corners and robot are initial values; the solver estimates them from the views. The other
    priors are fixed.

    Raises:
        ValueError: A standard deviation is not finite or not greater than zero.
    """

    pixel_px: float = 0.2
    """Corner noise per image coordinate, pixels."""
    robot_m: float = 1e-4
    """Position error of the reported flange pose per axis, metres. Errors of different poses are independent."""
    robot_rad: float = float(np.radians(0.02))
    """Rotation error of the reported flange pose per axis, radians."""
    smooth_m: float = 5e-5
    """Position error per axis that changes smoothly with the flange pose, metres."""
    smooth_rad: float = float(np.radians(0.01))
    """Rotation error per axis that changes smoothly with the flange pose, radians."""
    focal: float = 0.003
    """Relative error of fx and fy. The default covers factory calibration, temperature and focus."""
    centre: float = 0.0015
    """Error of cx and cy, in focal lengths. The default is about one pixel, as after a factory calibration."""
    scale: float = 0.002
    """Relative error of the board size. The default covers a careful measurement with a ruler."""
    estimate_noise: bool = True
    """Whether the noise levels are estimated from the views. If False, the given levels are used."""

    def __post_init__(self) -> None:
        for name in ("pixel_px", "robot_m", "robot_rad", "smooth_m", "smooth_rad", "focal", "centre", "scale"):
            value = getattr(self, name)
            if not 0 < value < np.inf:
                raise ValueError(
                    f"{name} is {value}: a standard deviation greater than zero is needed. For a value that is known "
                    "exactly, give a small one, for example 1e-9"
                )

    @property
    def noise(self) -> NoiseLevel:
        """Initial noise levels."""
        given = NoiseLevel(self.pixel_px, self.robot_m, self.robot_rad, self.smooth_m, self.smooth_rad)
        if not self.estimate_noise:
            return given
        # The estimate of a smooth error can stay at a low level, but does not stay at a level that is too high.
        return replace(
            given,
            smooth_m=max(self.smooth_m, SMOOTH_START_M),
            smooth_rad=max(self.smooth_rad, SMOOTH_START_RAD),
        )
