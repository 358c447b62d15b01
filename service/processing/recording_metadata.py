"""Read the database row of a recording that the cell made from its file."""

import hashlib
from pathlib import Path

from service.processing.upload_sandbox_main import describe
from service.storage.database import now
from service.storage.rows import RecordingRow


def describe_recording(recording_id: str, path: Path, sha256: str | None = None) -> RecordingRow:
    """Return the database row of a recording that the cell made.

    `service.processing.upload_sandbox` reads recordings from other sources.

    Args:
        recording_id: Id of the recording.
        path: The recording.
        sha256: SHA-256 of the file. None: it is computed.

    Raises:
        RecordingError: The recording cannot be used.
        OSError: The file cannot be read.
    """
    content = describe(path)
    sha256 = hash_file(path) if sha256 is None else sha256
    size_bytes = path.stat().st_size
    return RecordingRow(id=recording_id, created_at=now(), size_bytes=size_bytes, sha256=sha256, **content)


def hash_file(path: Path) -> str:
    """Return the SHA-256 of a file, hexadecimal. Raise OSError if it cannot be read."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
