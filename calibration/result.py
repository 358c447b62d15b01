"""Result of a hand-eye calibration: the transform, its covariance, the views, and the verdict."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from calibration.observations import Mounting

Verdict = Literal["accept", "warn", "refuse"]


@dataclass(frozen=True)
class Finding:
    """Problem found in a calibration, with a message for people."""

    code: str
    """Machine-readable code, for example `parallel-axes`."""
    message: str
    """Description of the problem, with its place and the remedy."""
    blocking: bool
    """True if the calibration must not be used; False for a warning."""


@dataclass(frozen=True)
class ViewReport:
    """Report on one view: whether the calibration uses the view, and the errors of the view."""

    name: str
    """Name of the view."""
    used: bool
    """True if the calibration was estimated from the view; False if the view was excluded."""
    reason: str | None
    """Why the view was excluded; None if it was used."""
    corners: int
    """Number of detected corners in the view."""
    rms_px: float | None
    """Root mean square reprojection residual per image coordinate, pixels; None if it cannot be computed. For an
    excluded view, the board pose is fitted to this view alone."""
    robot_error_m: float | None
    """Estimated position error of the reported flange pose, metres; None if it cannot be computed."""
    robot_error_rad: float | None
    """Estimated rotation error of the reported flange pose, radians; None if it cannot be computed."""
    loo_error_m: float | None
    """Leave-one-out error, metres. It is the distance between the observed middle of the board and its prediction from
    the other views. None if it cannot be computed."""
    distance_m: float | None
    """Distance from the camera to the middle of the board, metres; None if no board pose was found."""


@dataclass(frozen=True, eq=False)
class HandEyeResult:
    """Estimated calibration of any quality. Read `verdict` and `findings` before you use it."""

    mounting: Mounting
    """Whether the camera is on the flange or in the cell."""
    X: NDArray[np.float64]
    """(4, 4) camera pose, metres, `T_flange_camera` (eye-in-hand) or `T_base_camera` (eye-to-hand)."""
    covariance: NDArray[np.float64]
    """(6, 6) covariance of the error of X, camera frame, rotation rx, ry, rz (rad), then translation tx, ty, tz (m).
    `X_true = X @ from_rotation_vector(translation=(tx, ty, tz), rotation_vector=(rx, ry, rz))`."""
    Y: NDArray[np.float64]
    """(4, 4) board pose, metres, `T_base_board` (eye-in-hand) or `T_flange_board` (eye-to-hand)."""
    K: NDArray[np.float64]
    """(3, 3) fitted pinhole matrix, pixels."""
    board_scale: float
    """Estimated size of the board divided by its nominal size."""
    board_scale_sigma: float
    """Standard deviation of `board_scale`."""
    pixel_sigma_px: float
    """Estimated standard deviation of the corner noise per image coordinate, pixels."""
    robot_sigma_m: float
    """Estimated standard deviation of the robot position error per axis, metres."""
    robot_sigma_rad: float
    """Estimated standard deviation of the robot rotation error per axis, radians."""
    loo_error_m: float
    """Root mean square of the leave-one-out errors `ViewReport.loo_error_m` of the used views, metres."""
    repeatability_95_m: float
    """Predicted repeatability of a scan, metres. In 95 % of scans with eight views, no two views disagree by
    more than this."""
    views: tuple[ViewReport, ...]
    """One report per view, in the order of `Observations.views`."""
    findings: tuple[Finding, ...]
    """Problems of the calibration, the most serious first."""
    joint_covariance: NDArray[np.float64]
    """(17, 17) joint covariance of the errors of all shared unknowns. Verification needs the correlations.

    Order: X (6) and Y (6), each with rotation (rad), then translation (m); fx, fy, cx and cy, relative to the focal
    lengths (4); logarithm of the board scale (1).
    """

    @property
    def verdict(self) -> Verdict:
        """`refuse` if a finding is blocking, `warn` if all findings are warnings, `accept` without findings."""
        if any(finding.blocking for finding in self.findings):
            return "refuse"
        return "warn" if self.findings else "accept"

    @property
    def views_given(self) -> int:
        """Number of views that the solver was given."""
        return len(self.views)

    @property
    def views_used(self) -> int:
        """Number of views from which the calibration was estimated."""
        return sum(view.used for view in self.views)

    @property
    def sigma_m(self) -> float:
        """Standard deviation of the camera position (root sum of squares over the axes), metres."""
        return float(np.sqrt(np.trace(self.covariance[3:, 3:])))

    @property
    def sigma_rad(self) -> float:
        """Standard deviation of the camera rotation (root sum of squares over the axes), radians."""
        return float(np.sqrt(np.trace(self.covariance[:3, :3])))
