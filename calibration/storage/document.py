"""The JSON document of a calibration result, for the file, the command line and HTTP: the one definition of its parts.

Each class reads the fields of the dataclass that it describes. Members:

    mounting, frames        mounting of the camera, and a description of the two transforms
    T_flange_camera,        camera pose and board pose (eye-in-hand)
    T_base_board
    T_base_camera,          camera pose and board pose (eye-to-hand)
    T_flange_board
    covariance,             covariance of the camera pose, and of all shared unknowns of the solver
    joint_covariance
    intrinsics, board       fitted and given values
    metrics, verdict,       assessment
    findings, views
    verification            check with held-out views, if there were any

Units are metres, radians and pixels. Numbers that cannot be computed are null.
"""

from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, BeforeValidator, ConfigDict

from calibration.dataset.forms import transform_to_json
from calibration.geometry.transforms import NotRigidError, rigid
from calibration.observations import Mounting, Observations
from calibration.result import HandEyeResult, Verdict

FRAMES: dict[Mounting, tuple[tuple[str, str], tuple[str, str]]] = {
    "eye-in-hand": (
        ("T_flange_camera", "maps camera points to the flange; camera frame: x right, y down, z forward"),
        ("T_base_board", "maps board points to the robot's base; the board's z points into the print"),
    ),
    "eye-to-hand": (
        ("T_base_camera", "maps camera points to the robot's base; camera frame: x right, y down, z forward"),
        ("T_flange_board", "maps board points to the flange; the board's z points into the print"),
    ),
}
"""Name and description of the two transforms X and Y, by mounting."""
COVARIANCE = {
    "order": ["rx", "ry", "rz", "tx", "ty", "tz"],
    "convention": "right, in the camera's frame: X_true = X @ error, where X is the camera's transform and error has "
    "the rotation vector r and the translation t",
    "units": ["rad", "rad", "rad", "m", "m", "m"],
}
"""Convention of the covariance of X."""


def _finite(value: Any) -> Any:
    """Replace numbers that are not finite by None, since JSON has no NaN."""
    match value:
        case dict():
            return {key: _finite(item) for key, item in value.items()}
        case list() | tuple():
            return [_finite(item) for item in value]
        case np.generic() | np.ndarray():
            return _finite(value.tolist())
        case float() if not np.isfinite(value):
            return None
    return value


NumberOrNull = Annotated[float | None, BeforeValidator(_finite)]
"""A number, or null if it cannot be computed."""


class _Document(BaseModel):
    model_config = ConfigDict(from_attributes=True, use_attribute_docstrings=True)


class TransformResource(_Document):
    """A rigid transform."""

    xyz_m: list[float]
    """Translation, metres."""
    quat_xyzw: list[float]
    """Rotation as a unit quaternion."""


class CovarianceResource(_Document):
    """Covariance of the error of the camera pose, with its convention."""

    matrix: list[list[float | None]]
    """6 x 6; nulls without a solution."""
    order: list[str]
    """Order of the rows and columns."""
    convention: str
    """Definition of the error: the side of the transform on which it is multiplied, and its parts."""
    units: list[str]
    """Unit of each row and column."""


class FindingResource(_Document):
    """Problem found in a calibration, with a message for people."""

    code: str
    """Machine-readable code."""
    message: str
    """Description of the problem, with its place and the remedy."""
    blocking: bool
    """True if the calibration must not be used; false for a warning."""


class CalibrationViewReport(_Document):
    """Report on one view. Numbers that cannot be computed are null."""

    name: str
    """Name of the view."""
    used: bool
    """Whether the calibration was estimated from the view."""
    reason: str | None
    """Why the view was excluded; null if it was used."""
    corners: int
    """Number of detected corners in the view."""
    rms_px: NumberOrNull
    """Root mean square reprojection residual per image coordinate, pixels. For an excluded view, the board pose is
    fitted to this view alone."""
    robot_error_m: NumberOrNull
    """Estimated position error of the reported flange pose, metres."""
    robot_error_rad: NumberOrNull
    """Estimated rotation error of the reported flange pose, radians."""
    loo_error_m: NumberOrNull
    """Leave-one-out error, metres: distance between the observed middle of the board and its prediction from the other
    views."""
    distance_m: NumberOrNull
    """Distance from the camera to the middle of the board, metres."""


class CalibrationMetrics(_Document):
    """Accuracy of a calibration. Numbers are null without a solution."""

    sigma_m: NumberOrNull
    """Standard deviation of the camera position (root sum of squares over the axes), metres."""
    sigma_rad: NumberOrNull
    """Standard deviation of the camera rotation (root sum of squares over the axes), radians."""
    repeatability_95_m: NumberOrNull
    """Predicted repeatability of a scan, metres. In 95 % of scans with eight views, no two views disagree by more than
    this."""
    loo_error_m: NumberOrNull
    """Root mean square of the leave-one-out errors of the used views, metres."""
    pixel_sigma_px: NumberOrNull
    """Estimated standard deviation of the corner noise per image coordinate, pixels."""
    robot_sigma_m: NumberOrNull
    """Estimated standard deviation of the robot position error per axis, metres."""
    robot_sigma_rad: NumberOrNull
    """Estimated standard deviation of the robot rotation error per axis, radians."""
    views_given: int
    """Number of views that the solver was given."""
    views_used: int
    """Number of views from which the calibration was estimated."""


class VerificationView(_Document):
    """Position of the board in one view, according to the calibration."""

    name: str
    """Name of the view."""
    deviation_m: float
    """Distance of the middle of the board from where it lay, metres."""
    deviation_rad: float
    """Rotation of the board relative to where it lay, radians."""
    expected_m: float
    """Expected root mean square of `deviation_m`, from the covariance of the calibration and the noise, metres."""
    expected_rad: float
    """Expected root mean square of `deviation_rad`, radians."""


class VerificationResource(_Document):
    """Check of a calibration with views that were not used to estimate it."""

    passed: bool
    """Whether the calibration still holds. A board that was moved does not contradict it."""
    message: str
    """Result and what to do, for people."""
    max_deviation_m: NumberOrNull
    """Largest `deviation_m`; null without views."""
    expected_m: NumberOrNull
    """Largest `expected_m`; null without views."""
    max_deviation_rad: NumberOrNull
    """Largest `deviation_rad`; null without views."""
    expected_rad: NumberOrNull
    """Largest `expected_rad`; null without views."""
    board_displacement_m: float | None
    """Distance by which the board moved, metres, if the views agree that it did; otherwise null."""
    board_rotation_rad: float | None
    """Rotation of the board about its normal, radians; null if `board_displacement_m` is null."""
    views: list[VerificationView]
    """The views in which the board was seen."""


class CalibrationResult(_Document):
    """A solved calibration of a camera on the flange."""

    verdict: Verdict
    """Whether the calibration may be used."""
    findings: list[FindingResource]
    """Problems of the calibration, the most serious first."""
    T_flange_camera: TransformResource | None
    """Pose of the camera on the flange; null without a solution."""
    T_base_board: TransformResource | None
    """Pose of the board in the base frame; null without a solution."""
    covariance: CovarianceResource
    """Covariance of `T_flange_camera`."""
    intrinsics: dict[str, Any]
    """Camera matrix, fitted and given, with the image size and the distortion."""
    board: dict[str, Any]
    """Board with its nominal size, and its estimated scale."""
    metrics: CalibrationMetrics
    """Accuracy."""
    views: list[CalibrationViewReport]
    """One entry per view, in the given order."""


def result_document(
    result: HandEyeResult, observations: Observations, verification: dict[str, Any] | None = None
) -> dict[str, Any]:
    """Return a solved calibration as JSON values, without the corners.

    Args:
        result: The calibration.
        observations: The views that it was solved from.
        verification: Result on views that were held out, as JSON values. None: not verified.
    """
    (camera, camera_description), (board, board_description) = FRAMES[result.mounting]
    width, height = observations.image_size
    document: dict[str, Any] = {
        "mounting": result.mounting,
        "frames": {camera: camera_description, board: board_description},
        camera: _transform(result.X),
        board: _transform(result.Y),
        "covariance": {"matrix": result.covariance.tolist()} | COVARIANCE,
        "joint_covariance": result.joint_covariance.tolist(),
        "intrinsics": {
            "K": result.K.tolist(),
            "K_given": observations.K.tolist(),
            "distortion": observations.distortion.tolist(),
            "width": width,
            "height": height,
        },
        "board": observations.board.to_json() | {"scale": result.board_scale, "scale_sigma": result.board_scale_sigma},
        "metrics": CalibrationMetrics.model_validate(result).model_dump(mode="json"),
        "verdict": result.verdict,
        "findings": [FindingResource.model_validate(finding).model_dump() for finding in result.findings],
        "views": [CalibrationViewReport.model_validate(view).model_dump(mode="json") for view in result.views],
    }
    if verification is not None:
        document["verification"] = verification
    return _finite(document)


def _transform(T: NDArray[np.float64]) -> dict[str, list[float]] | None:
    """Return a transform as JSON values, or None if it is not rigid, as for a refused solution."""
    try:
        return transform_to_json(rigid(T, "the solution"))
    except NotRigidError:
        return None
