"""What a hand-eye calibration gives: the transform, how sure it is, what was left out, and whether to use it."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from calibration.observations import Mounting

Verdict = Literal["accept", "warn", "refuse"]


@dataclass(frozen=True)
class Finding:
    """Something that speaks against a calibration."""

    code: str
    """For programs, as "parallel-axes"."""
    words: str
    """What was found, where, and after a colon what to do, for a person at the cell."""
    refuses: bool
    """Whether the calibration must not be used; else it is a warning."""


@dataclass(frozen=True)
class ViewReport:
    """What became of one view."""

    name: str
    used: bool
    reason: str | None
    """Why it was left out, in words."""
    corners: int
    rms_px: float | None
    """Reprojection error with the calibration as solved; None where it could not be worked out."""
    robot_error_m: float | None
    """How far the robot was from where it said, as the solution has it."""
    robot_error_rad: float | None
    left_out_m: float | None
    """How far off the board appears by the calibration solved without this view."""
    distance_m: float | None
    """From the camera to the board's middle."""


@dataclass(frozen=True, eq=False)
class HandEyeResult:
    """A solved calibration, be it good or bad: see `verdict` and `findings` before using it."""

    mounting: Mounting
    X: NDArray[np.float64]
    """(4, 4) `T_flange_camera`; `T_base_camera` where the camera stands in the cell (eye-to-hand)."""
    covariance: NDArray[np.float64]
    """(6, 6) of the error (rx, ry, rz, tx, ty, tz), rad and m, in the camera's frame: `X_true = X @ exp(error)`, the
    rotation by the rotation vector and the translation added before it (`from_rotation_vector(t, r)`)."""
    Y: NDArray[np.float64]
    """(4, 4) `T_base_board`; `T_flange_board` where the camera stands in the cell."""
    K: NDArray[np.float64]
    """(3, 3) as fitted."""
    board_scale: float
    """The board's true size by the views, as a share of the told one."""
    board_scale_sigma: float
    pixel_sigma_px: float
    """Noise of one corner's coordinate, estimated."""
    robot_sigma_m: float
    """Noise of the robot's poses along one axis, estimated."""
    robot_sigma_rad: float
    left_out_m: float
    """Root mean square of the views' `left_out_m`."""
    eight_views_m: float
    """Predicted: 95 % of the time, no two of eight views of a scan disagree by more."""
    views: tuple[ViewReport, ...]
    """In the order given."""
    findings: tuple[Finding, ...]
    joint_covariance: NDArray[np.float64] | None = None
    """(17, 17) by the views, of the errors of X and, alike, of Y, then of fx, fy, cx and cy as shares of the focal
    lengths, and of the logarithm of the board's scale; from poses alone of the first 12; None: not known. It tells how
    surely the board appears where it lay, as these errors hang together: that of a board which is larger than told,
    seen from one distance, is made up for by the others."""

    @property
    def verdict(self) -> Verdict:
        """Whether it may be used."""
        if any(finding.refuses for finding in self.findings):
            return "refuse"
        return "warn" if self.findings else "accept"

    @property
    def sigma_m(self) -> float:
        """Root mean square error of the camera's place, all axes together, by the covariance."""
        return float(np.sqrt(np.trace(self.covariance[3:, 3:])))

    @property
    def sigma_rad(self) -> float:
        """The same of its direction."""
        return float(np.sqrt(np.trace(self.covariance[:3, :3])))
