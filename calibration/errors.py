"""What is refused of a hand-eye calibration, each with a slug that the service and the command line pass on."""


class HandEyeError(ValueError):
    """A hand-eye calibration that cannot be used."""

    slug = "calibration"


class HandEyeMissingError(HandEyeError):
    """There is no such file."""

    slug = "calibration-missing"


class HandEyeUnreadableError(HandEyeError):
    """The file is there but cannot be read: no permission, a folder, too large."""

    slug = "calibration-unreadable"


class HandEyeInvalidError(HandEyeError):
    """The content is not a calibration: not JSON, another form, not rigid, millimetres."""

    slug = "calibration-invalid"


class HandEyeStaleError(HandEyeError):
    """It is older than allowed."""

    slug = "calibration-stale"


class HandEyeOfTheFutureError(HandEyeError):
    """It claims to have been made later than now: one of two clocks is wrong, and its age is unknown."""

    slug = "calibration-of-the-future"


class HandEyeMismatchError(HandEyeError):
    """It is of another camera or of another robot."""

    slug = "calibration-mismatch"


class HandEyeRefusedError(HandEyeError):
    """It was solved, and found not good enough to be used."""

    slug = "calibration-refused"


class CalibrationFolderError(HandEyeError):
    """A calibration's folder, or the observations in it, cannot be used."""

    slug = "calibration-folder"


class HandEyeInputError(HandEyeError):
    """Views that no calibration can be solved from. `slug` says which check they failed, as "parallel-axes"."""

    def __init__(self, slug: str, words: str) -> None:
        super().__init__(words)
        self.slug = slug


class BoardDetectionError(ValueError):
    """An image in which the calibration board was not found as it should be."""

    slug = "board-detection"


class BoardImageError(BoardDetectionError):
    """No picture: another shape or type of numbers than a camera's image."""

    slug = "board-image"


class BoardNotSeenError(BoardDetectionError):
    """The board is not there, or too little of it to tell where it is."""

    slug = "board-not-seen"


class BoardMirroredError(BoardDetectionError):
    """The board is there, but left and right (or top and bottom) are swapped: no pose would fit the robot's."""

    slug = "board-mirrored"
