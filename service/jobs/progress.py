"""Progress of jobs, as their rows keep it: a listener of the cell that writes to the database."""

from dataclasses import asdict

from cell.control.progress import BoardObservation, ViewTiming
from cell.recording import RecordingWriter
from service.errors import JobKind
from service.jobs.job import kind_of
from service.metrics.scans import ScanMetrics
from service.storage.rows import CalibrationRow, ScanRow
from service.storage.store import Store

VIEWS_FRACTION: dict[JobKind, float] = {"scan": 0.95, "calibration": 0.9, "verification": 0.9}
"""Fraction of a job's duration that taking the views takes."""


class StoredProgress:
    """Writes the progress of a live scan, a calibration or a verification. It is a `ProgressListener`.

    The intent is written before each move, and the outcome of each view after it.
    """

    def __init__(
        self,
        store: Store,
        job: ScanRow | CalibrationRow,
        views: int,
        recording: RecordingWriter | None = None,
        metrics: ScanMetrics | None = None,
    ) -> None:
        """Create the listener; nothing is written yet.

        Args:
            store: Store with the row of the job.
            job: Row of the job.
            views: Number of planned views.
            recording: Recording of a scan. The rows of its views name their bytes in it.
            metrics: Metrics that count the views of a scan.
        """
        self._id = job.id
        self._kind: JobKind = kind_of(job)
        self._jobs, self._calibrations = store.jobs(self._kind), store.calibrations
        self._views, self._done = views, 0
        self._recording, self._metrics = recording, metrics
        self._moving_to: int | None = None

    def moving(self, index: int) -> None:
        """Write the intent. The arm moves after this returns."""
        self._moving_to = index
        self._jobs.set_view(self._id, index, "moving")

    def recorded(self, index: int, timing: ViewTiming) -> None:
        """Write that a view is on disk. The row of a scan's view has its durations, byte range and hash."""
        written = {} if self._recording is None else asdict(self._recording.written(index)) | asdict(timing)
        self._jobs.set_view(self._id, index, "recorded", **written)
        if self._metrics is not None:
            self._metrics.count_recorded_view()
        self._advance()

    def missing(self, index: int, reason: str) -> None:
        """Write why there is no such view."""
        self._jobs.set_view(self._id, index, "missing", reason)
        if self._metrics is not None:
            # The arm is not sent to a viewpoint that it cannot reach.
            self._metrics.count_missing_view("camera" if index == self._moving_to else "unreachable")
        self._advance()

    def detected(self, index: int, board: BoardObservation, coverage: float) -> None:
        """Write which corners were detected in an image; `coverage` is that of all images so far."""
        self._calibrations.update_view(self._id, index, **asdict(board))
        self._calibrations.update(self._id, ("scanning", "processing"), coverage=coverage)

    def not_detected(self, index: int, reason: str) -> None:
        """Write why the board was not detected in an image."""
        self._calibrations.update_view(self._id, index, corners=0, cells=[], reason=reason)

    def home(self) -> None:
        """Write that the arm is home and the solver runs."""
        self._calibrations.update(self._id, ("scanning",), state="processing", stage="solving")

    def _advance(self) -> None:
        self._done += 1
        fraction = round(VIEWS_FRACTION[self._kind] * self._done / self._views, 3)
        # A scan has no such stage: recognition may have begun.
        going_home = self._done == self._views and self._kind != "scan"
        stage = "going-home" if going_home else "views"
        self._jobs.update(self._id, ("scanning",), stage=stage, fraction=fraction)
