"""Stubs for the slow parts of a service.

The stub of recognition writes a fixed result in the same way as the real one. Untrusted recordings are read in this
process.
"""

import errno
from collections.abc import Callable, Iterable, Sequence
from functools import cache
from pathlib import Path

from calibration.atomic_write import write_synced
from cell.control.progress import MissingView
from cell.devices import View
from recognition.result import Recognition
from service.processing.recording_metadata import describe_recording
from service.processing.results import STAGE_START_FRACTION, Outcome, recognise_recording, write_results
from service.processing.worker import OnCheck, TaskFailedError
from service.processing.worker_main import Task
from service.storage.rows import RecordingRow

PICTURE = b"\x89PNG\r\n\x1a\n of nothing"


class RecognitionStub:
    """Stub for `service.processing.worker.RecognitionWorker` with a fixed result."""

    alive, start_count = True, 1
    starting, not_ready_reason = False, None

    def __init__(self, recognition: Recognition) -> None:
        self._recognition = recognition

    def prepare(self) -> None:
        """Do nothing: the stub has no process."""

    start = kill = close = prepare

    def run(
        self,
        task: Task,
        on_stage: Callable[[str], None],
        timeout_s: float,
        views: Iterable[View] = (),
        missing: Sequence[MissingView] = (),
        on_check: OnCheck = lambda _: None,
        next_is_here: Callable[[], bool] = lambda: False,
    ) -> Outcome:
        """Wait for the end of the views, then write the fixed result."""
        for _ in views:
            pass
        for stage in STAGE_START_FRACTION:
            on_stage(stage)
        try:
            outcome = write_results(self._recognition, task.results)
        except OSError as error:
            if error.errno != errno.ENOSPC:
                raise
            raise TaskFailedError("storage-full", "no space is left in the data folder") from error
        try:
            write_synced(task.preview, PICTURE)
        except OSError:
            task.preview.unlink(missing_ok=True)
        return outcome

    def wait_for_preview(self) -> bool:
        """Return True: the preview is already written, or failed."""
        return True


def stub_factory(recording: Path) -> Callable[[], RecognitionStub]:
    """Return a factory of stubs whose result is that of this recording."""
    recognition = _recognised(recording)
    return lambda: RecognitionStub(recognition)


@cache
def _recognised(recording: Path) -> Recognition:
    return recognise_recording(recording)


def describe_here(recording_id: str, path: Path, sha256: str) -> RecordingRow:
    """Describe a recording in this process. Stub for `upload_sandbox.describe_untrusted_recording`."""
    return describe_recording(recording_id, path, sha256)
