"""What the hand-eye file may hold; fields that are not named here are left to their writers."""

from datetime import datetime
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, AliasPath, Field, PlainValidator

from calibration.board import Board
from calibration.file_forms import Form, Matrix3, Numbers6, Transform
from calibration.hand_eye_result import Verdict
from calibration.observations import Mounting

ASYMMETRY = 1e-6
"""Share of the two variances' geometric mean by which a covariance and its transpose may differ."""

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


def _board(value: Any) -> Board | None:
    """Without what was found of its size."""
    if isinstance(value, dict):
        value = {key: told for key, told in value.items() if key not in ("scale", "scale_sigma")}
    return None if value is None else Board.from_json(value)


def _time(value: Any) -> datetime | None:
    if value is None:
        return None
    try:
        time = datetime.fromisoformat(value)
    except (TypeError, ValueError):
        raise ValueError(f'{str(value)[:40]!r} is no time; one as "2026-01-31T12:00:00+00:00" is needed') from None
    if time.tzinfo is None:
        raise ValueError(f"{value!r} lacks the time zone, as +00:00")
    return time


class _Finding(Form):
    code: str
    words: str
    refuses: bool = False


class _Covariance(Form):
    matrix: Annotated[list[Numbers6], Field(min_length=6, max_length=6), AfterValidator(_covariance)]


class _Intrinsics(Form):
    K: Matrix3


class Metrics(Form):
    """How sure it is."""

    robot_sigma_m: NotNegative | None = None
    robot_sigma_rad: NotNegative | None = None
    eight_views_m: NotNegative | None = None


class JudgedForm(Form):
    """Whether it may be used: one that was refused may hold any transform."""

    schema_version: Literal[1] = 1
    mounting: Mounting = "eye-in-hand"
    T_base_camera: Any = None
    verdict: Verdict | None = None
    findings: Annotated[list[_Finding], Field(fail_fast=True)] | None = None


class HandEyeForm(JudgedForm):
    """One that was not refused, of a camera on the flange."""

    T_flange_camera: Transform
    created: Annotated[datetime | None, PlainValidator(_time)] = None
    camera_id: str | None = None
    robot_serial: str | None = None
    covariance: _Covariance | None = None
    T_base_board: Transform | None = None
    board: Annotated[Board | None, PlainValidator(_board)] = None
    board_scale: NotNegative | None = Field(None, validation_alias=AliasPath("board", "scale"))
    intrinsics: _Intrinsics | None = None
    metrics: Metrics | None = None
