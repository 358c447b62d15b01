"""Errors of point clouds from other programs."""

from cell.recording.errors import RecordingError


class CloudError(RecordingError):
    """Point clouds that cannot become a recording; the message says what to do."""

    slug = "cloud"
