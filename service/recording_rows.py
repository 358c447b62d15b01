"""What the store keeps of a recording, read from its file."""

import hashlib
from pathlib import Path

from cell.recording import read_recording
from service.database import now
from service.tables import RecordingRow


def describe_recording(recording_id: str, path: Path, sha256: str | None = None) -> RecordingRow:
    """The row of the recording at `path`; `sha256` where it is known already.

    Raises:
        RecordingError: it cannot be used.
    """
    recording = read_recording(path)
    if sha256 is None:
        with path.open("rb") as file:
            sha256 = hashlib.file_digest(file, "sha256").hexdigest()
    header = recording.header
    return RecordingRow(
        id=recording_id,
        created_at=now(),
        size_bytes=path.stat().st_size,
        sha256=sha256,
        views=len(recording.views),
        missing=list(recording.missing),
        string_radius_m=header.string_radius_m,
        table_z_m=header.table_z_m,
        provenance=dict(header.provenance),
    )
