"""Progress of jobs, as their rows keep it: listeners of the cell that write to the database."""

from cell.control.calibration_run import BoardObservation
from cell.control.scan_loop import missing_view
from cell.recording import RecordingWriter
from service.metrics.scans import ScanMetrics
from service.storage.calibration_store import CalibrationStore
from service.storage.store import Store

SCAN_VIEWS_FRACTION = 0.95
"""Fraction of a live scan's duration that taking the views takes."""
CALIBRATION_VIEWS_FRACTION = 0.9
"""Fraction of a calibration's duration that taking the views takes."""


class StoredProgress:
    """Writes the progress of a live scan: the intent before each move, and the outcome of each view."""

    def __init__(self, store: Store, scan_id: str, views: int, writer: RecordingWriter, metrics: ScanMetrics) -> None:
        self.reasons: list[str] = []
        """Messages about missing views, which become warnings of the model."""
        self._store, self._scan_id, self._views, self._done = store, scan_id, views, 0
        self._writer, self._metrics = writer, metrics
        self._moving_to: int | None = None

    def moving(self, index: int) -> None:
        """Write the intent. The arm moves after this returns."""
        self._moving_to = index
        self._store.set_view(self._scan_id, index, "moving")

    def recorded(self, index: int) -> None:
        """Write the state, byte range and hash of a view that is on disk."""
        self._store.set_view(self._scan_id, index, "recorded", written=self._writer.written(index))
        self._metrics.count_recorded_view()
        self._advance()

    def missing(self, index: int, reason: str) -> None:
        """Write why there is no such view."""
        self.reasons.append(missing_view(index, reason))
        self._store.set_view(self._scan_id, index, "missing", reason)
        # The arm is not sent to a viewpoint that it cannot reach.
        self._metrics.count_missing_view("camera" if index == self._moving_to else "unreachable")
        self._advance()

    def _advance(self) -> None:
        self._done += 1
        fraction = round(SCAN_VIEWS_FRACTION * self._done / self._views, 3)
        self._store.update_scan(self._scan_id, ("scanning",), stage="views", fraction=fraction)


class StoredCalibrationProgress:
    """Writes the progress of a calibration: the intent before each move, and what was detected in each view."""

    def __init__(self, store: CalibrationStore, calibration_id: str, views: int) -> None:
        self._store, self._id, self._views, self._done = store, calibration_id, views, 0

    def moving(self, index: int) -> None:
        """Write the intent. The arm moves after this returns."""
        self._store.set_view(self._id, index, "moving")

    def recorded(self, index: int) -> None:
        """Write that the image of a view is on disk."""
        self._store.set_view(self._id, index, "recorded")
        self._advance()

    def missing(self, index: int, reason: str) -> None:
        """Write why there is no such view."""
        self._store.set_view(self._id, index, "missing", reason)
        self._advance()

    def detected(self, index: int, board: BoardObservation, coverage: float) -> None:
        """Write which corners were detected in an image; `coverage` is that of all images so far."""
        self._store.set_seen(self._id, index, board)
        self._store.update(self._id, ("scanning", "processing"), coverage=coverage)

    def not_detected(self, index: int, reason: str) -> None:
        """Write why the board was not detected in an image."""
        self._store.set_unseen(self._id, index, reason)

    def home(self) -> None:
        """Write that the arm is home and the solver runs."""
        self._store.update(self._id, ("scanning",), state="processing", stage="solving")

    def _advance(self) -> None:
        self._done += 1
        fraction = CALIBRATION_VIEWS_FRACTION * self._done / self._views
        self._store.update(self._id, ("scanning",), stage="views", fraction=fraction)
        if self._done == self._views:
            self._store.update(self._id, ("scanning",), stage="going-home")
