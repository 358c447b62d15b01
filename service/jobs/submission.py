"""What may begin: scans and calibrations, accepted one at a time."""

from collections.abc import Callable
from typing import Any

from calibration.target.board import Board
from cell.control.cell import Cell
from recognition.model.model import Method
from service.jobs.cell_lock import Place
from service.jobs.job import Running
from service.jobs.new_rows import NOBODY, Asked, new_calibration, new_scan
from service.storage.rows import CalibrationRow, RecordingRow, ScanRow
from service.storage.store import Store


class Submissions:
    """Accepts what somebody wants done; on return it is on the disk, and it has begun. Nothing moves before that.

    Safe to use from any thread. Every method raises ServiceError: `cell-busy`, with what is under way; and
    those that need the cell raise CellError: why the cell cannot do it.
    """

    def __init__(self, store: Store, cell: Cell, place: Place, begin: Callable[[Running[Any]], None]) -> None:
        self._store, self._cell, self._place, self._begin = store, cell, place, begin

    def replay(
        self,
        recording: RecordingRow,
        method: Method,
        radius_m: float | None,
        asked: Asked = NOBODY,
        source: str | None = None,
    ) -> ScanRow:
        """A scan from a recording, `source` the scan that it does again.

        Raises:
            sqlite3.IntegrityError: the recording was removed a moment ago.
        """
        with self._place.taken():
            scan = new_scan("replay", method, radius_m, asked, recording=recording.id, source=source)
            self._accept(Running(scan, None), lambda: self._store.add_scan(scan, asked.key_row(scan)))
            return scan

    def live(
        self,
        views: int | None,
        method: Method,
        radius_m: float | None,
        requested_at: float,
        asked: Asked = NOBODY,
    ) -> ScanRow:
        """A scan by the cell, once the cell is ready and the scan is planned; refused when the arm was stopped since
        `requested_at`, however long this had to wait.

        Takes seconds where the cell has to be connected first.
        """
        with self._place.taken():
            prepared = self._cell.prepare_scan(views, requested_at)
            scan = new_scan("live", method, radius_m, asked, calibration_sha256=prepared.hand_eye.sha256)
            self._accept(Running(scan, prepared), lambda: self._store.add_scan(scan, asked.key_row(scan)))
            return scan

    def calibration(self, board: Board, poses: int, requested_at: float) -> CalibrationRow:
        """A calibration with the board on the table, as `live` does a scan."""
        with self._place.taken():
            prepared = self._cell.prepare_calibration(board, requested_at, poses)
            row = new_calibration("calibration", board, poses, warnings=prepared.plan.warnings)
            self._accept(Running(row, prepared), lambda: self._store.calibrations.add(row))
            return row

    def verification(self, requested_at: float) -> CalibrationRow:
        """A capture of the board, where it was left, from two poses."""
        with self._place.taken():
            prepared = self._cell.prepare_verification(requested_at)
            row = new_calibration("verification", None, len(prepared.plan.viewpoints), prepared.hand_eye.sha256)
            self._accept(Running(row, prepared), lambda: self._store.calibrations.add(row))
            return row

    def _accept(self, running: Running[Any], write: Callable[[], None]) -> None:
        """Has the row of what the place is taken for written, and begins it."""
        self._place.accept(running, write, lambda: self._begin(running))
