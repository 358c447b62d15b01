"""What is assumed of the cell before its views are looked at."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class NoiseLevel:
    """Standard deviations along or about one axis."""

    pixel_px: float
    robot_m: float
    robot_rad: float

    @property
    def robot(self) -> NDArray[np.float64]:
        """(6,) of a robot's error: about three axes, along three."""
        return np.array([self.robot_rad] * 3 + [self.robot_m] * 3)

    def is_near(self, other: "NoiseLevel", share: float) -> bool:
        """Whether no level differs by more than a `share`."""
        mine, theirs = (np.array([n.pixel_px, n.robot_m, n.robot_rad]) for n in (self, other))
        return bool((np.abs(mine - theirs) <= share * theirs).all())


@dataclass(frozen=True)
class Assumed:
    """Standard deviations. Those of the noise are where its estimation starts; the others are priors and stay.

    Raises:
        ValueError: one that is not greater than zero.
    """

    pixel_px: float = 0.2
    """Noise of one corner's coordinate."""
    robot_m: float = 1e-4
    """Error of the robot's pose along one axis of the flange, anew in every pose."""
    robot_rad: float = float(np.radians(0.02))
    """The same about one axis."""
    focal: float = 0.003
    """Of the told fx and fy, each, as a share: factory calibration, warming up, focus."""
    centre: float = 0.0015
    """Of the told cx and cy, each, as a share of the focal length: about a pixel, as factory calibrations go."""
    scale: float = 0.002
    """Of the board's told pitch, as a share: a careful measurement with a ruler."""
    estimate_noise: bool = True
    """Whether the views say how large the noise is; else it is taken as told."""

    def __post_init__(self) -> None:
        for name in ("pixel_px", "robot_m", "robot_rad", "focal", "centre", "scale"):
            value = getattr(self, name)
            if not 0 < value < np.inf:
                raise ValueError(
                    f"{name} is {value}: a standard deviation is needed, greater than zero; of what is known exactly "
                    "give a small one, as 1e-9"
                )

    @property
    def noise(self) -> NoiseLevel:
        """Where the estimation starts."""
        return NoiseLevel(self.pixel_px, self.robot_m, self.robot_rad)
