"""What the hand-eye file may hold; fields that are not named here are left to their writers."""

import reprlib
from typing import Annotated, Any, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, AliasPath, Field, PlainValidator, TypeAdapter, model_validator

from calibration.dataset.forms import STRICT, Form, Numbers6, PinholeMatrix, Time, to_transform
from calibration.geometry.transforms import with_nearest_rotation
from calibration.observations import Mounting
from calibration.result import Verdict
from calibration.storage.document import COVARIANCE
from calibration.target.board import Board

ASYMMETRY = 1e-6
"""Share of the two variances' geometric mean by which a covariance and its transpose may differ."""

JOINT_SHAPES = ((12, 12), (17, 17))

_MATRIX = TypeAdapter(list[Annotated[list[float], Field(min_length=12, max_length=17)]], config=STRICT)
NotNegative = Annotated[float, Field(ge=0)]


def _covariance(matrix: list[list[float]]) -> list[list[float]]:
    """Refuses what no error can have."""
    values = np.array(matrix)
    variances = np.diag(values)
    if (variances > 0).all():
        # Scaled, because metres and radians differ by orders of magnitude.
        scaled = values / np.sqrt(np.outer(variances, variances))
        if np.abs(scaled - scaled.T).max() <= ASYMMETRY and np.linalg.eigvalsh(scaled).min() > 0:
            return matrix
    raise ValueError("it is no covariance, which is symmetric and positive definite")


def _joint_covariance(value: Any) -> NDArray[np.float64] | None:
    """Of X and Y, and perhaps camera and board; its parts may hang together as closely as rounding allows."""
    if value is None:
        return None
    matrix = np.array(_MATRIX.validate_python(value))
    if matrix.shape in JOINT_SHAPES and (np.diag(matrix) > 0).all():
        scaled = matrix / np.sqrt(np.outer(np.diag(matrix), np.diag(matrix)))
        if np.abs(scaled - scaled.T).max() <= ASYMMETRY and np.linalg.eigvalsh(scaled).min() > -ASYMMETRY:
            return matrix
    raise ValueError("it is no covariance of 12 or 17 errors")


def _board(value: Any) -> Board | None:
    """Without what was found of its size."""
    if isinstance(value, dict):
        value = {key: told for key, told in value.items() if key not in ("scale", "scale_sigma")}
    return None if value is None else Board.from_json(value)


def _exact_transform(value: Any) -> NDArray[np.float64]:
    """Read a transform and make its rotation exact: the inverse kinematics find no joint angles for a rounded one."""
    return with_nearest_rotation(to_transform(value))


ExactTransform = Annotated[NDArray[np.float64], PlainValidator(_exact_transform)]
CovarianceMatrix = Annotated[list[Numbers6], Field(min_length=6, max_length=6), AfterValidator(_covariance)]


class _Finding(Form):
    code: str
    words: str
    refuses: bool = False


class _Covariance(Form):
    matrix: CovarianceMatrix
    order: list[str] | None = None
    side: str | None = None
    units: list[str] | None = None

    @model_validator(mode="after")
    def _as_ours(self) -> Self:
        """Refuses one of another frame, order or unit, whose numbers would be taken for others."""
        for name, ours in COVARIANCE.items():
            told = getattr(self, name)
            if told is not None and told != ours:
                raise ValueError(f"its {name} is {reprlib.repr(told)}; {ours} is needed")
        return self


class _Intrinsics(Form):
    K: PinholeMatrix


class _Verification(Form):
    passed: bool
    words: str = "the file does not say why"
    views: list[Any] = Field(default_factory=list)


class Metrics(Form):
    """How sure it is."""

    robot_sigma_m: NotNegative | None = None
    robot_sigma_rad: NotNegative | None = None
    eight_views_m: NotNegative | None = None
    views_used: Annotated[int, Field(ge=0)] | None = None


class JudgedForm(Form):
    """Whether it may be used: one that was refused may hold any transform."""

    schema_version: Literal[1] = 1
    mounting: Mounting = "eye-in-hand"
    T_base_camera: Any = None
    verdict: Verdict | None = None
    findings: Annotated[list[_Finding], Field(fail_fast=True)] | None = None
    verification: _Verification | None = None

    @property
    def refusals(self) -> tuple[str, ...]:
        """Why it must not be used, in words; empty: it may be. The verdict alone is not relied on."""
        words = [finding.words for finding in self.findings or [] if finding.refuses]
        # Without views nothing was verified, which is no failure.
        if self.verification is not None and self.verification.views and not self.verification.passed and not words:
            words = [f"on views that were held out, {self.verification.words}"]
        if self.verdict == "refuse" and not words:
            words = ["calibrate anew; the file does not say why"]
        return tuple(words)


class HandEyeForm(JudgedForm):
    """One that was not refused, of a camera on the flange."""

    T_flange_camera: ExactTransform
    created: Time | None = None
    camera_id: str | None = None
    robot_serial: str | None = None
    covariance: _Covariance | None = None
    joint_covariance: Annotated[NDArray[np.float64] | None, PlainValidator(_joint_covariance)] = None
    T_base_board: ExactTransform | None = None
    board: Annotated[Board | None, PlainValidator(_board)] = None
    board_scale: NotNegative | None = Field(None, validation_alias=AliasPath("board", "scale"))
    intrinsics: _Intrinsics | None = None
    metrics: Metrics | None = None
