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
