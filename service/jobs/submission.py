"""Accepts scans, calibrations and verifications, one at a time."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from calibration.target.board import Board
from cell.config.scan_views import Views
from cell.control.cell import Cell
from recognition.request import RecognitionRequest
from service.jobs.cell_lock import CellLock
from service.jobs.job import Job, UnpreparedScan
from service.storage.database import new_id, now
from service.storage.idempotency_keys import Key
from service.storage.rows import CalibrationRow, KeyRow, RecordingRow, ScanRow
from service.storage.store import Store


@dataclass(frozen=True)
class Requester:
    """Who requests a scan, and with which idempotency key."""

    name: str | None = None
    """Name of the caller's token; None if no token is needed."""
    key: Key | None = None
    """Idempotency key of the request."""

    def key_row(self, scan: ScanRow) -> KeyRow | None:
        """Return the row of the key, which refers to the accepted scan."""
        key = self.key
        return None if key is None else KeyRow(key.caller, key.key, key.body_sha256, scan.id, scan.created_at)


NOBODY = Requester()
"""Requester of a scan that was not requested over HTTP."""


class Submissions:
    """Accepts jobs. When a method returns, the row of the job is on disk and the job has begun; nothing moved before.

    Safe to use from any thread. Every method raises ServiceError with `cell-busy` while another job runs. Those that
    need the cell raise CellError with the reason why it cannot do the job.
    """

    def __init__(self, store: Store, cell: Cell, lock: CellLock, begin: Callable[[Job[Any]], None]) -> None:
        self._store, self._cell, self._lock, self._begin = store, cell, lock, begin

    def replay(
        self,
        recording: RecordingRow,
        request: RecognitionRequest,
        requester: Requester = NOBODY,
        source: str | None = None,
    ) -> ScanRow:
        """Accept a scan of a recording.

        Args:
            recording: The recording.
            request: How to recognise it.
            requester: Who requests the scan.
            source: Id of the scan that is reprocessed.

        Raises:
            sqlite3.IntegrityError: The recording was removed a moment ago.
        """
        with self._lock.reserved():
            scan = new_scan(
                "replay",
                request,
                requester,
                recording=recording.id,
                source=source,
                simulated=recording.simulated,
            )
            with self._lock.accepting(Job(scan, None), self._begin):
                self._store.scans.add(scan, requester.key_row(scan))
            return scan

    def live(
        self,
        views: Views | None,
        request: RecognitionRequest,
        requested_at: float,
        requester: Requester = NOBODY,
    ) -> ScanRow:
        """Accept a live scan. No device is contacted: the job connects and plans.

        Args:
            views: Number of viewpoints or `auto`; None for the configured value.
            request: How to recognise the views.
            requested_at: Time of the request, monotonic seconds. The scan is refused if the arm was stopped since.
            requester: Who requests the scan.
        """
        with self._lock.reserved():
            self._cell.check_scan(requested_at)
            scan = new_scan(
                "live",
                request,
                requester,
                simulated=self._cell.settings.simulated,
                views=self._cell.settings.for_views(views).scan.views,
            )
            with self._lock.accepting(Job(scan, UnpreparedScan(views, requested_at)), self._begin):
                self._store.scans.add(scan, requester.key_row(scan))
            return scan

    def calibration(self, board: Board, poses: int, requested_at: float) -> CalibrationRow:
        """Accept a calibration with the board on the table. `requested_at` is as for `live`."""
        with self._lock.reserved():
            prepared = self._cell.prepare_calibration(board, requested_at, poses)
            row = new_calibration("calibration", board, poses, warnings=prepared.plan.warnings)
            with self._lock.accepting(Job(row, prepared), self._begin):
                self._store.calibrations.add(row)
            return row

    def verification(self, requested_at: float) -> CalibrationRow:
        """Accept a verification: captures of the board from two poses. `requested_at` is as for `live`."""
        with self._lock.reserved():
            prepared = self._cell.prepare_verification(requested_at)
            row = new_calibration("verification", None, len(prepared.plan.viewpoints), prepared.hand_eye.sha256)
            with self._lock.accepting(Job(row, prepared), self._begin):
                self._store.calibrations.add(row)
            return row


def new_scan(
    mode: Literal["replay", "live"],
    request: RecognitionRequest,
    requester: Requester,
    *,
    recording: str | None = None,
    source: str | None = None,
    simulated: bool | None = None,
    views: Views | None = None,
) -> ScanRow:
    """Return the row of a scan that is accepted now. The state of a live scan is `connecting`.

    Args:
        mode: Kind of scan.
        request: How to recognise it.
        requester: Who requests the scan.
        recording: Id of the recording of a replay.
        source: Id of the scan that is reprocessed.
        simulated: Whether the arm or the camera is simulated. None: not known.
        views: Number of viewpoints of a live scan, or `auto`.
    """
    return ScanRow(
        id=new_id(),
        mode=mode,
        recording=recording,
        request=request,
        state="queued" if mode == "replay" else "connecting",
        stage=None,
        fraction=0.0,
        created_at=now(),
        started_at=None,
        ended_at=None,
        summary=None,
        failure=None,
        source=source,
        requested_by=requester.name,
        simulated=simulated,
        views=views,
    )


def new_calibration(
    kind: Literal["calibration", "verification"],
    board: Board | None,
    poses: int,
    sha256: str | None = None,
    warnings: Sequence[str] = (),
) -> CalibrationRow:
    """Return the row of a calibration or verification that is accepted now.

    Args:
        kind: Kind of run.
        board: Board on the table; None in a verification, which uses the board of the calibration.
        poses: Number of poses.
        sha256: Hash of the calibration that is verified.
        warnings: Warnings of the plan.
    """
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
