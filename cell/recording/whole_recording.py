"""Write a recording completely or not at all."""

import os
from collections.abc import Iterable
from pathlib import Path

from calibration.atomic_write import sync_folder
from cell.devices import View
from cell.recording.errors import RecordingExistsError
from cell.recording.header import RecordingHeader
from cell.recording.writer import RecordingWriter


def require_new(out: Path) -> None:
    """Check that nothing would be overwritten.

    Raises:
        RecordingExistsError: There is a file `out`.
    """
    if out.exists():
        raise RecordingExistsError(f"{out} exists already; nothing is overwritten: choose another name")


def write_whole(out: Path, header: RecordingHeader, views: Iterable[View]) -> None:
    """Write the new recording `out`: under another name first, then renamed.

    Raises:
        RecordingError: A view cannot be recorded.
        OSError: The file cannot be written.
    """
    unfinished = out.with_name(f".{out.name}.{os.getpid()}.partial")
    try:
        with RecordingWriter(unfinished, header) as writer:
            for view in views:
                writer.write_view(view)
        unfinished.replace(out)
    finally:
        unfinished.unlink(missing_ok=True)
    sync_folder(out.parent)
