"""Result of a hand-eye calibration: the transform, its covariance, the views, and the verdict."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from calibration.observations import Mounting

Verdict = Literal["accept", "warn", "refuse"]


@dataclass(frozen=True)
class Finding:
    """Something that speaks against a calibration, with a message for people."""

    code: str
    """Code for programs, for example `parallel-axes`."""
    message: str
    """What was found, where, and what to do."""
    blocking: bool
    """Whether the calibration must not be used. Otherwise, the finding is a warning."""


@dataclass(frozen=True)
class ViewReport:
    """How the solver used one view."""

    name: str
    """Name of the view."""
    used: bool
    """Whether the calibration was solved from it."""
    reason: str | None
    """Why the view was excluded; None if it was used."""
    corners: int
    """Number of corners in the view."""
    rms_px: float | None
    """Reprojection error with the solved calibration, pixels, root mean square; None if it cannot be computed."""
    robot_error_m: float | None
    """Estimated position error of the reported flange pose, metres."""
    robot_error_rad: float | None
    """Estimated rotation error of the reported flange pose, radians."""
    loo_error_m: float | None
    """Leave-one-out error, the distance of the middle of the board from where the other views predict it, metres.
    None if it cannot be computed."""
    distance_m: float | None
    """Distance from the camera to the middle of the board, metres."""


@dataclass(frozen=True, eq=False)
class HandEyeResult:
    """A solved calibration, good or bad. Read `verdict` and `findings` before you use it."""

    mounting: Mounting
    """Whether the camera is on the flange or stands in the cell."""
    X: NDArray[np.float64]
    """(4, 4) `T_flange_camera`; `T_base_camera` for a camera that stands in the cell (eye-to-hand)."""
    covariance: NDArray[np.float64]
    """(6, 6) covariance of the error (rx, ry, rz, tx, ty, tz) of X, radians and metres, in the camera frame.
    `X_true = X @ from_rotation_vector((tx, ty, tz), (rx, ry, rz))`."""
    Y: NDArray[np.float64]
    """(4, 4) `T_base_board`; `T_flange_board` for a camera that stands in the cell."""
    K: NDArray[np.float64]
    """(3, 3) fitted pinhole matrix, pixels."""
    board_scale: float
    """Estimated size of the board, as a share of the given size."""
    board_scale_sigma: float
    """One sigma of `board_scale`."""
    pixel_sigma_px: float
    """Estimated noise of one coordinate of a corner, pixels, one sigma."""
    robot_sigma_m: float
    """Estimated noise of the robot's position along one axis, metres, one sigma."""
    robot_sigma_rad: float
    """Estimated noise of the robot's rotation about one axis, radians, one sigma."""
    loo_error_m: float
    """Leave-one-out error, the root mean square of `loo_error_m` of the views used, metres."""
    repeatability_95_m: float
    """Predicted repeatability of a scan, metres. In 95 % of scans, no two of eight views disagree by more."""
    views: tuple[ViewReport, ...]
    """One report per view, in the given order."""
    findings: tuple[Finding, ...]
    """Reasons against the calibration, the most serious first."""
    joint_covariance: NDArray[np.float64]
    """(17, 17) covariance of the errors of X, of Y, of fx, fy, cx and cy as shares of the focal lengths, and of the
    logarithm of the scale of the board, in this order. Verification uses it, since these errors are correlated."""

    @property
    def verdict(self) -> Verdict:
        """Whether the calibration may be used (`accept`, `warn` or `refuse`)."""
        if any(finding.blocking for finding in self.findings):
            return "refuse"
        return "warn" if self.findings else "accept"

    @property
    def sigma_m(self) -> float:
        """One sigma of the camera position, all axes together, metres."""
        return float(np.sqrt(np.trace(self.covariance[3:, 3:])))

    @property
    def sigma_rad(self) -> float:
        """One sigma of the camera rotation, all axes together, radians."""
        return float(np.sqrt(np.trace(self.covariance[:3, :3])))
