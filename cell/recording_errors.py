"""What is refused of a recording, each with a slug that the service and the command line pass on."""


class RecordingError(ValueError):
    """A recording that cannot be written or read."""

    slug = "recording"


class RecordingExistsError(RecordingError):
    """The file to be written is there already; recordings are never overwritten."""

    slug = "recording-exists"


class RecordingUnreadableError(RecordingError):
    """No such file, not a regular file, or no permission."""

    slug = "recording-unreadable"


class NotMcapError(RecordingError):
    """The file is empty or of another format."""

    slug = "not-mcap"


class RecordingTooLargeError(RecordingError):
    """The file, or something that it announces, is beyond a limit."""

    slug = "recording-too-large"


class RecordingCorruptError(RecordingError):
    """The file's records contradict themselves or fail their checksum."""

    slug = "recording-corrupt"


class RecordingHeaderError(RecordingError):
    """The metadata or the hand-eye calibration is missing or makes no sense."""

    slug = "recording-header"


class RecordingContentError(RecordingError):
    """A view's content is wrong: such a recording is not trusted at all."""

    slug = "recording-content"


class RecordingEmptyError(RecordingError):
    """Not one view is complete."""

    slug = "recording-empty"
