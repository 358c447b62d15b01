"""Errors of a folder of depth images."""

from cell.recording.errors import RecordingError


class FramesError(RecordingError):
    """A folder of depth images that cannot become a recording; the message says what to do."""

    slug = "frames"
