"""Recordings as their resources."""

from service.api.schemas.scans import RecordingLinks, RecordingResource
from service.storage.rows import RecordingRow

RECORDINGS = "/api/recordings"


def recording_resource(row: RecordingRow) -> RecordingResource:
    """The recording as it is told."""
    own = f"{RECORDINGS}/{row.id}"
    return RecordingResource(**vars(row), links=RecordingLinks(self=own, file=f"{own}/file"))
