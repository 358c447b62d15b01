"""Errors of the hand-eye calibration. Each has a `slug`, which the service and the command line report."""


class HandEyeError(ValueError):
    """Base of the errors of a hand-eye calibration that cannot be used."""

    slug = "calibration"


class HandEyeMissingError(HandEyeError):
    """The file does not exist."""

    slug = "calibration-missing"


class HandEyeUnreadableError(HandEyeError):
    """The file cannot be read: no permission, a folder, or too large."""

    slug = "calibration-unreadable"


class HandEyeInvalidError(HandEyeError):
    """The content is not a calibration: not JSON, another format, not rigid, or in millimetres."""

    slug = "calibration-invalid"


class HandEyeStaleError(HandEyeError):
    """The calibration is older than allowed."""

    slug = "calibration-stale"


class HandEyeFutureDateError(HandEyeError):
    """The date of the calibration is in the future, so its age is not known. One of two clocks is wrong."""

    slug = "calibration-in-future"


class HandEyeMismatchError(HandEyeError):
    """The calibration is of another camera or another robot."""

    slug = "calibration-mismatch"


class HandEyeRefusedError(HandEyeError):
    """The calibration must not be used: a finding is blocking, its verification failed, or its verdict is `refuse`."""

    slug = "calibration-refused"


class CalibrationFolderError(HandEyeError):
    """The folder of a calibration, or the observations in it, cannot be used."""

    slug = "calibration-folder"


class HandEyeInputError(HandEyeError):
    """No calibration can be solved from the views.

    Args:
        slug: The check that failed, for example `parallel-axes`.
        message: Message for people.
    """

    def __init__(self, slug: str, message: str) -> None:
        super().__init__(message)
        self.slug = slug


class BoardDetectionError(ValueError):
    """The calibration board was not detected in an image."""

    slug = "board-detection"


class BoardImageError(BoardDetectionError):
    """The array is not an image: another shape or type."""

    slug = "board-image"


class BoardNotSeenError(BoardDetectionError):
    """The board is not in the image, or too little of it is visible."""

    slug = "board-not-seen"


class BoardMirroredError(BoardDetectionError):
    """The board is mirrored in the image."""

    slug = "board-mirrored"
