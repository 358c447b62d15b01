"""Scans and calibrations as they are accepted."""

from collections.abc import Sequence
from typing import Literal

from calibration.board import Board
from recognition.model import Method
from service.database import new_id, now
from service.tables import CalibrationRow, ScanRow


def new_scan(mode: Literal["replay", "live"], method: Method, radius_m: float | None, recording: str | None) -> ScanRow:
    """A scan that waits for its beginning; `recording` is the one that a replay is of."""
    return ScanRow(
        id=new_id(),
        mode=mode,
        recording=recording,
        method=method,
        string_radius_m=radius_m,
        state="queued",
        stage=None,
        fraction=0.0,
        created_at=now(),
        started_at=None,
        ended_at=None,
        summary=None,
        problem=None,
    )


def new_calibration(
    kind: Literal["calibration", "verification"],
    board: Board | None,
    poses: int,
    sha256: str | None = None,
    warnings: Sequence[str] = (),
) -> CalibrationRow:
    """A calibration that waits for its beginning; `sha256` of the one that a verification is of, `warnings` of its
    plan."""
    return CalibrationRow(
        id=new_id(),
        kind=kind,
        board=None if board is None else board.to_json(),
        poses=poses,
        warnings=list(warnings),
        calibration_sha256=sha256,
        state="queued",
        stage=None,
        fraction=0.0,
        coverage=0.0,
        created_at=now(),
        started_at=None,
        ended_at=None,
        activated_at=None,
        result=None,
        verification=None,
        problem=None,
    )
