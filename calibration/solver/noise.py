"""Noise levels and priors of the calibration."""

from dataclasses import astuple, dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class NoiseLevel:
    """Standard deviations of the noise, along or about one axis."""

    pixel_px: float
    """Noise of one coordinate of a corner, pixels."""
    robot_m: float
    """Position error of a reported flange pose along one axis, metres."""
    robot_rad: float
    """Rotation error of a reported flange pose about one axis, radians."""

    @property
    def robot(self) -> NDArray[np.float64]:
        """(6,) standard deviations of a robot error: rotation about three axes, translation along three."""
        return np.array([self.robot_rad] * 3 + [self.robot_m] * 3)

    def is_close(self, other: "NoiseLevel", relative_tolerance: float) -> bool:
        """Return whether no level differs by more than `relative_tolerance` of that of `other`."""
        return np.allclose(astuple(self), astuple(other), rtol=relative_tolerance, atol=0.0)


@dataclass(frozen=True)
class NoisePriors:
    """Prior standard deviations of the solver.

    The noise sigmas are initial values and are estimated again from the views. The others are fixed priors.

    Raises:
        ValueError: A standard deviation is not greater than zero.
    """

    pixel_px: float = 0.2
    """Noise of one coordinate of a corner, pixels."""
    robot_m: float = 1e-4
    """Position error of a reported flange pose along one axis, metres, independent in each pose."""
    robot_rad: float = float(np.radians(0.02))
    """Rotation error of a reported flange pose about one axis, radians."""
    focal: float = 0.003
    """Prior of fx and of fy, as a share, for factory calibration, temperature and focus."""
    centre: float = 0.0015
    """Prior of cx and of cy, as a share of the focal length. About a pixel, as for a factory calibration."""
    scale: float = 0.002
    """Prior of the size of the board, as a share, for a careful measurement with a ruler."""
    estimate_noise: bool = True
    """Whether the noise is estimated from the views. Otherwise, the given values are used."""

    def __post_init__(self) -> None:
        for name in ("pixel_px", "robot_m", "robot_rad", "focal", "centre", "scale"):
            value = getattr(self, name)
            if not 0 < value < np.inf:
                raise ValueError(
                    f"{name} is {value}: a standard deviation greater than zero is needed. For a value that is known "
                    "exactly, give a small one, for example 1e-9"
                )

    @property
    def noise(self) -> NoiseLevel:
        """The noise levels at which the estimation starts."""
        return NoiseLevel(self.pixel_px, self.robot_m, self.robot_rad)
