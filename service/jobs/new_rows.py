"""Scans and calibrations as they are accepted."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from calibration.target.board import Board
from recognition.model.model import Method
from service.storage.database import new_id, now
from service.storage.idempotency_keys import Key
from service.storage.rows import CalibrationRow, KeyRow, ScanRow


@dataclass(frozen=True)
class Asked:
    """Who asked for a scan, and how."""

    by: str | None = None
    """Name of his token; None: nobody has to say who he is."""
    key: Key | None = None
    """With which idempotency key."""

    def key_row(self, scan: ScanRow) -> KeyRow | None:
        """The key, now that it is known which scan it was used for."""
        key = self.key
        return None if key is None else KeyRow(key.caller, key.key, key.body_sha256, scan.id, scan.created_at)


NOBODY = Asked()
"""Not asked for over HTTP."""


def new_scan(
    mode: Literal["replay", "live"],
    method: Method,
    radius_m: float | None,
    asked: Asked,
    *,
    recording: str | None = None,
    source: str | None = None,
    calibration_sha256: str | None = None,
) -> ScanRow:
    """A scan that waits for its beginning; `recording` is the one that a replay is of, `source` the scan that it does
    again, `calibration_sha256` of what a live one was planned with."""
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
        failure=None,
        source=source,
        asked_by=asked.by,
        calibration_sha256=calibration_sha256,
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
        failure=None,
    )
