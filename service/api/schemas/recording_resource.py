"""Conversion of recording rows to their JSON documents."""

from service.api.schemas.addresses import RECORDINGS
from service.api.schemas.scans import RecordingLinks, RecordingResource
from service.storage.rows import RecordingRow


def recording_resource(row: RecordingRow) -> RecordingResource:
    """Return a recording as a document."""
    own = f"{RECORDINGS}/{row.id}"
    return RecordingResource(**vars(row), links=RecordingLinks(self=own, file=f"{own}/file"))
