"""What recognition refuses, each with a slug that the service and the command line pass on."""


class RecognitionError(ValueError):
    """Input from which no truthful model can be made."""

    slug = "recognition"


class InvalidParametersError(RecognitionError):
    """Parameters that break one of the conditions of Table I, or a radius that is no string's."""

    slug = "invalid-parameters"


class InsufficientViewsError(RecognitionError):
    """Fewer usable views than the method needs."""

    slug = "insufficient-views"


class TooCrowdedError(RecognitionError):
    """More above the table than strings and a few things beside them: the table's height or the workspace is wrong."""

    slug = "too-crowded"


class NoDepthError(RecognitionError):
    """No view holds a single depth measurement in the workspace: the camera or the setup is at fault."""

    slug = "no-depth"
