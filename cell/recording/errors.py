"""Errors of recordings. Each has a `slug`, which the service and the command line report."""

MAX_SHOWN = 100
"""Largest number of characters of a foreign name in a message."""


class RecordingError(ValueError):
    """Base of all errors of recordings: the recording cannot be written or read."""

    slug = "recording"


class RecordingExistsError(RecordingError):
    """The file exists already; recordings are never overwritten."""

    slug = "recording-exists"


class RecordingUnreadableError(RecordingError):
    """There is no such file, it is not a regular file, or there is no permission."""

    slug = "recording-unreadable"


class NotMcapError(RecordingError):
    """The file is empty or of another format."""

    slug = "not-mcap"


class RecordingTooLargeError(RecordingError):
    """The file, or a size in it, exceeds a limit."""

    slug = "recording-too-large"


class RecordingCorruptError(RecordingError):
    """The records of the file contradict one another or fail their checksum."""

    slug = "recording-corrupt"


class RecordingHeaderError(RecordingError):
    """The metadata or the hand-eye calibration is missing or not valid."""

    slug = "recording-header"


class RecordingContentError(RecordingError):
    """The content of a view is wrong, so the whole recording is refused."""

    slug = "recording-content"


class RecordingEmptyError(RecordingError):
    """No view is complete."""

    slug = "recording-empty"


def shown(name: object) -> str:
    """Return a name out of a foreign file as it can go to a terminal: printable, and not too long."""
    text = "".join(c if c.isprintable() else "?" for c in str(name)[: MAX_SHOWN + 1])
    return text if len(text) <= MAX_SHOWN else f"{text[:MAX_SHOWN]}..."
