"""Recordings as their resources."""

from service.schemas import RecordingLinks, RecordingResource
from service.tables import RecordingRow

RECORDINGS = "/api/recordings"


def recording_resource(row: RecordingRow) -> RecordingResource:
    """The recording as it is told."""
    own = f"{RECORDINGS}/{row.id}"
    return RecordingResource(**vars(row), links=RecordingLinks(self=own, file=f"{own}/file"))
