"""Recordings of scans as MCAP files.

In: views, a header and a result. Out: a file that can be read after a crash; read back, the same views or an error that
says what is wrong with the file.

The names below are the package's interface. `RecordingWriter` and the readers are imported at their first use, because
the MCAP and protobuf libraries take a tenth of a second that a caller of the errors does not need.
"""

import importlib
from typing import TYPE_CHECKING, Any

from cell.recording.errors import (
    NotMcapError,
    RecordingContentError,
    RecordingCorruptError,
    RecordingEmptyError,
    RecordingError,
    RecordingExistsError,
    RecordingHeaderError,
    RecordingTooLargeError,
    RecordingUnreadableError,
)
from cell.recording.limits import DEFAULT_LIMITS, Limits

if TYPE_CHECKING:
    from cell.recording.header import RecordingHeader
    from cell.recording.reader import Recording, read_recording, read_result
    from cell.recording.writer import RecordingWriter

__all__ = [
    "DEFAULT_LIMITS",
    "Limits",
    "NotMcapError",
    "Recording",
    "RecordingContentError",
    "RecordingCorruptError",
    "RecordingEmptyError",
    "RecordingError",
    "RecordingExistsError",
    "RecordingHeader",
    "RecordingHeaderError",
    "RecordingTooLargeError",
    "RecordingUnreadableError",
    "RecordingWriter",
    "read_recording",
    "read_result",
]

_MODULES = {
    "Recording": "reader",
    "RecordingHeader": "header",
    "RecordingWriter": "writer",
    "read_recording": "reader",
    "read_result": "reader",
}


def __getattr__(name: str) -> Any:
    """Import a name of the interface at its first use."""
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_MODULES[name]}"), name)
