"""Errors of recognition. Those with a `slug` are reported by the service and the command line."""


class RecognitionError(ValueError):
    """Base of all errors of recognition: no truthful model can be made from the input."""

    slug = "recognition"


class InvalidParametersError(RecognitionError):
    """The parameters break a condition of Table I, or the radius is not the radius of a string."""

    slug = "invalid-parameters"


class InvalidSceneError(RecognitionError):
    """The table height or the workspace is not valid."""

    slug = "invalid-scene"


class InvalidGripperError(RecognitionError):
    """A dimension of the gripper is not valid."""

    slug = "invalid-gripper"


class DuplicateViewError(RecognitionError):
    """Two views have the same index."""

    slug = "duplicate-view"


class InsufficientViewsError(RecognitionError):
    """No view was given, or only one view shows a string and others show a bare table."""

    slug = "insufficient-views"


class ContradictingViewsError(RecognitionError):
    """The views show different scenes, and no majority of them agrees."""

    slug = "contradicting-views"


class NoDepthError(RecognitionError):
    """No view has a depth measurement in the workspace. Check the camera and the setup."""

    slug = "no-depth"


class TableElsewhereError(RecognitionError):
    """The views show the table too far from where it is given, in height or tilt, or show nothing near it."""

    slug = "table-elsewhere"


class DepthNoiseError(RecognitionError):
    """The depth of the table scatters too much for the height threshold or the radius of the string."""

    slug = "depth-noise"


class TooCrowdedError(RecognitionError):
    """Too much is above the table. The height of the table or the workspace is probably wrong."""

    slug = "too-crowded"


class RadiusUnknownError(RecognitionError):
    """Nothing above the table allows the radius of a string to be measured. Give the radius."""

    slug = "radius-unknown"


class TopologyError(ValueError):
    """The chains and the crossings of a model contradict each other."""

    slug = "topology"


class ModelError(ValueError):
    """The document is not a model of schema `pointchain/2`, or it contradicts itself."""
