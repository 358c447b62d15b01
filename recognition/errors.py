"""Errors of recognition. Each has a `slug`, which the service and the command line report."""


class RecognitionError(ValueError):
    """Base of all errors of recognition: no truthful model can be made from the input."""

    slug = "recognition"


class InvalidParametersError(RecognitionError):
    """The parameters break a condition of Table I, or the radius is not the radius of a string."""

    slug = "invalid-parameters"


class InsufficientViewsError(RecognitionError):
    """Fewer than two views can be used."""

    slug = "insufficient-views"


class TooCrowdedError(RecognitionError):
    """Too much is above the table. The height of the table or the workspace is probably wrong."""

    slug = "too-crowded"


class NoDepthError(RecognitionError):
    """No view has a depth measurement in the workspace. Check the camera and the setup."""

    slug = "no-depth"
