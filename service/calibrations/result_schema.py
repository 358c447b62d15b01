"""A solved calibration as it goes over HTTP: what `calibration.storage.document` writes. Metres, radians, pixels."""

from typing import Any

from calibration.result import Verdict
from service.described import Described


class TransformResource(Described):
    """A rigid transform."""

    xyz_m: list[float]
    quat_xyzw: list[float]


class CovarianceResource(Described):
    """Of the error of the camera's pose."""

    matrix: list[list[float | None]]
    """Of nulls where there is no solution."""
    order: list[str]
    side: str
    """To which side of the transform the error is multiplied, and how it is made up."""
    units: list[str]


class FindingResource(Described):
    """Something that speaks against a calibration."""

    code: str
    words: str
    refuses: bool
    """Whether the calibration must not be used for it; else it is a warning."""


class SolvedView(Described):
    """What became of one view in solving; null: it could not be worked out."""

    name: str
    used: bool
    reason: str | None
    """Why it was left out."""
    corners: int
    rms_px: float | None
    robot_error_m: float | None
    robot_error_rad: float | None
    left_out_m: float | None
    """How far off the board appears by the calibration solved without this view."""
    distance_m: float | None


class CalibrationMetrics(Described):
    """How sure a calibration is; null: it has no solution."""

    sigma_m: float | None
    sigma_rad: float | None
    eight_views_m: float | None
    """Predicted: 95 % of the time, no two of eight views of a scan disagree by more."""
    left_out_m: float | None
    pixel_sigma_px: float | None
    robot_sigma_m: float | None
    robot_sigma_rad: float | None
    views_given: int
    views_used: int


class CalibrationResult(Described):
    """A solved calibration."""

    verdict: Verdict
    findings: list[FindingResource]
    T_flange_camera: TransformResource | None
    """Null: there is no solution."""
    T_base_board: TransformResource | None
    covariance: CovarianceResource
    intrinsics: dict[str, Any]
    """The camera's matrix as fitted and as told."""
    board: dict[str, Any]
    """As told, with its scale by the views."""
    metrics: CalibrationMetrics
    views: list[SolvedView]


class VerifiedView(Described):
    """Where one view puts the board."""

    name: str
    off_m: float
    """How far its middle appears from where it lay."""
    off_rad: float
    """By how much it appears turned."""
    expected_m: float
    """Root mean square of `off_m` by the calibration's covariance and the noise."""
    expected_rad: float | None = None
    """The same of `off_rad`; null in verifications of before it was told."""


class VerificationResource(Described):
    """A calibration on views that it was not solved from."""

    passed: bool
    """Nothing contradicts where the camera is said to be. A board that was moved does not."""
    words: str
    """For a person at the cell."""
    worst_m: float | None
    """Largest `off_m` of the views; null without any."""
    expected_m: float | None
    """Largest `expected_m`."""
    worst_rad: float | None = None
    """Largest `off_rad`; this and the other angles are null, too, in verifications of before they were told."""
    expected_rad: float | None = None
    """Largest `expected_rad`."""
    board_moved_m: float | None
    """The views agree that the board was moved, its middle so far; null where it was not, or they do not agree."""
    board_turned_rad: float | None = None
    """By how much it was turned thereby about its normal."""
    views: list[VerifiedView]
