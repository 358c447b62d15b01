"""Recordings as their resources."""

from service.api.schemas.addresses import RECORDINGS
from service.api.schemas.scans import RecordingLinks, RecordingResource
from service.storage.rows import RecordingRow


def recording_resource(row: RecordingRow) -> RecordingResource:
    """The recording as it is told."""
    own = f"{RECORDINGS}/{row.id}"
    return RecordingResource(**vars(row), links=RecordingLinks(self=own, file=f"{own}/file"))
