"""What the store keeps of a recording that the cell made, read from its file."""

import hashlib
from pathlib import Path

from service.processing.upload_sandbox_main import describe
from service.storage.database import now
from service.storage.rows import RecordingRow


def describe_recording(recording_id: str, path: Path, sha256: str | None = None) -> RecordingRow:
    """The row of the recording at `path`; `sha256` where it is known already.

    A recording of somebody else is for `service.processing.upload_sandbox`.

    Raises:
        RecordingError: it cannot be used.
    """
    content = describe(path)
    if sha256 is None:
        with path.open("rb") as file:
            sha256 = hashlib.file_digest(file, "sha256").hexdigest()
    size_bytes = path.stat().st_size
    return RecordingRow(id=recording_id, created_at=now(), size_bytes=size_bytes, sha256=sha256, **content)
