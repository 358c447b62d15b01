"""Schema for reading hand-eye files. Unknown members are ignored."""

import reprlib
from typing import Annotated, Any, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, AliasPath, Field, PlainValidator, TypeAdapter, model_validator

from calibration.dataset.forms import STRICT_CONFIG, Form, PinholeMatrix, Timestamp, Vector6, transform_from_json
from calibration.geometry.transforms import with_nearest_rotation
from calibration.observations import Mounting
from calibration.result import Verdict
from calibration.storage.document import COVARIANCE
from calibration.target.board import Board

MAX_ASYMMETRY = 1e-6
"""Maximum asymmetry of a correlation matrix."""

JOINT_SHAPES = ((12, 12), (17, 17))
"""Accepted shapes of a joint covariance: 17 errors as in `HandEyeResult`, or the 12 errors of X and Y."""

_MATRIX = TypeAdapter(list[Annotated[list[float], Field(min_length=12, max_length=17)]], config=STRICT_CONFIG)
NotNegative = Annotated[float, Field(ge=0)]


def _covariance(matrix: list[list[float]]) -> list[list[float]]:
    """Check that a matrix is symmetric and positive definite."""
    values = np.array(matrix)
    variances = np.diag(values)
    if (variances > 0).all():
        # Scaled, because metres and radians differ by orders of magnitude.
        scaled = values / np.sqrt(np.outer(variances, variances))
        if np.abs(scaled - scaled.T).max() <= MAX_ASYMMETRY and np.linalg.eigvalsh(scaled).min() > 0:
            return matrix
    raise ValueError("this is not a covariance, which is symmetric and positive definite")


def _joint_covariance(value: Any) -> NDArray[np.float64] | None:
    """Parse a joint covariance. Its errors may be fully correlated, so it may be singular up to rounding."""
    if value is None:
        return None
    matrix = np.array(_MATRIX.validate_python(value))
    if matrix.shape in JOINT_SHAPES and (np.diag(matrix) > 0).all():
        scaled = matrix / np.sqrt(np.outer(np.diag(matrix), np.diag(matrix)))
        if np.abs(scaled - scaled.T).max() <= MAX_ASYMMETRY and np.linalg.eigvalsh(scaled).min() > -MAX_ASYMMETRY:
            return matrix
    raise ValueError("this is not a covariance of 12 or 17 errors")


def _board(value: Any) -> Board | None:
    """Parse the board with its nominal size. The members for the estimated scale are ignored."""
    if value is None:
        return None
    if isinstance(value, dict):
        value = {key: item for key, item in value.items() if key not in ("scale", "scale_sigma")}
    return Board.from_json(value)


def _exact_transform(value: Any) -> NDArray[np.float64]:
    """Parse a transform and make its rotation exact. The inverse kinematics find no solution for a rounded rotation."""
    return with_nearest_rotation(transform_from_json(value))


ExactTransform = Annotated[NDArray[np.float64], PlainValidator(_exact_transform)]
CovarianceMatrix = Annotated[list[Vector6], Field(min_length=6, max_length=6), AfterValidator(_covariance)]


class _Finding(Form):
    code: str
    message: str
    blocking: bool = False


class _Covariance(Form):
    matrix: CovarianceMatrix
    order: list[str] | None = None
    convention: str | None = None
    units: list[str] | None = None

    @model_validator(mode="after")
    def _check_convention(self) -> Self:
        """Refuse a covariance with another frame, order or unit, because its numbers would be misinterpreted."""
        for name, expected in COVARIANCE.items():
            given = getattr(self, name)
            if given is not None and given != expected:
                raise ValueError(f"its {name} is {reprlib.repr(given)}; {expected} is needed")
        return self


class _Intrinsics(Form):
    K: PinholeMatrix


class _Verification(Form):
    passed: bool
    message: str = "the file does not say why"
    views: list[Any] = Field(default_factory=list)


class Metrics(Form):
    """Accuracy of a calibration, as in `storage.document.CalibrationMetrics`."""

    robot_sigma_m: NotNegative | None = None
    robot_sigma_rad: NotNegative | None = None
    repeatability_95_m: NotNegative | None = None
    views_used: Annotated[int, Field(ge=0)] | None = None


class JudgedForm(Form):
    """Members that decide whether a calibration may be used. The transform of a refused calibration is not checked."""

    schema_version: Literal[1] = 1
    mounting: Mounting = "eye-in-hand"
    T_base_camera: Any = None
    verdict: Verdict | None = None
    findings: Annotated[list[_Finding], Field(fail_fast=True)] | None = None
    verification: _Verification | None = None

    @property
    def refusals(self) -> tuple[str, ...]:
        """Reasons why the calibration must not be used; empty if it may be used. `verdict` may be missing."""
        reasons = [finding.message for finding in self.findings or [] if finding.blocking]
        # A verification without views has no result, so it is not a failure.
        if self.verification is not None and self.verification.views and not self.verification.passed and not reasons:
            reasons = [f"on views that were held out, {self.verification.message}"]
        if self.verdict == "refuse" and not reasons:
            reasons = ["the file does not say why; calibrate again"]
        return tuple(reasons)


class HandEyeForm(JudgedForm):
    """Calibration of a camera on the flange that was not refused."""

    T_flange_camera: ExactTransform
    created: Timestamp | None = None
    camera_id: str | None = None
    robot_serial: str | None = None
    covariance: _Covariance | None = None
    joint_covariance: Annotated[NDArray[np.float64] | None, PlainValidator(_joint_covariance)] = None
    T_base_board: ExactTransform | None = None
    board: Annotated[Board | None, PlainValidator(_board)] = None
    board_scale: NotNegative | None = Field(None, validation_alias=AliasPath("board", "scale"))
    intrinsics: _Intrinsics | None = None
    metrics: Metrics | None = None

    @property
    def covariance_matrix(self) -> NDArray[np.float64] | None:
        """(6, 6) covariance of the error of X."""
        if self.covariance is None:
            return None
        return np.array(self.covariance.matrix)

    @property
    def camera_matrix(self) -> NDArray[np.float64] | None:
        """(3, 3) fitted pinhole matrix, pixels."""
        if self.intrinsics is None:
            return None
        return np.array(self.intrinsics.K)
