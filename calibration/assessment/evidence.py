"""What the gates judge a solved calibration by."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.observations import Mounting


@dataclass(frozen=True, eq=False)
class Evidence:
    """A solution and what it was solved from, view by view. What poses alone do not tell is None."""

    mounting: Mounting
    names: tuple[str, ...]
    """(N) of the views, in the order given."""
    T_base_flange: NDArray[np.float64]
    """(N, 4, 4) as the robot told it."""
    T_camera_board: NDArray[np.float64]
    """(N, 4, 4) of each view by itself, with the camera and board as told; NaN where a view gave none."""
    used: NDArray[np.bool_]
    """(N,) which views agree with one another and were solved from."""
    distance_m: NDArray[np.float64]
    """(N,) from the camera to the board's middle; NaN where a view gave no pose."""
    X: NDArray[np.float64]
    """(4, 4) as in `HandEyeResult`."""
    Y: NDArray[np.float64]
    """(4, 4) as in `HandEyeResult`."""
    covariance: NDArray[np.float64]
    """(6, 6) as in `HandEyeResult`, before anything is added for what could not be verified."""
    robot_sigma_m: float
    """Noise of the robot's poses along one axis, estimated."""
    robot_sigma_rad: float
    left_out_m: float
    """Root mean square, over the views used, of how far off each appears by the calibration without it."""
    lever_m: NDArray[np.float64]
    """(3,) from the flange to what is looked at, along the camera's axes."""
    pixel_sigma_px: float | None = None
    """Noise of one corner's coordinate, estimated."""
    K_told: NDArray[np.float64] | None = None
    """(3, 3) as the camera told it."""
    K: NDArray[np.float64] | None = None
    """(3, 3) as fitted."""
    k1: float | None = None
    """Radial distortion left in the pictures, as `calibration.solver.residual_distortion` reads it."""
    k1_sigma: float | None = None
    board_scale: float | None = None
    """The board's true size by the views, as a share of the told one."""
    board_scale_sigma: float | None = None
    settled: bool = True
    """False: the solution still moved when its steps ran out, or none led on; not asked of poses alone."""
