"""Profile of a depth camera: the size of its errors on a flat table, as a value and as JSON."""

import types
import typing
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any


class ProfileError(ValueError):
    """A camera cannot be measured with the given images, or the document is no profile."""


@dataclass(frozen=True)
class DepthProfile:
    """Errors of a depth camera on a flat table.

    Lengths are along the optical axis at `distance_m`. The errors of a stereo camera grow with the square of the
    distance, so all are converted to that distance.
    """

    width: int
    """Width of the depth image, pixels."""
    height: int
    """Height of the depth image, pixels."""
    focal_px: float
    """Focal length of the depth image, pixels."""
    poses: int
    """Number of poses from which the table was seen."""
    exposures: int
    """Number of depth images per pose, of the pose with most of them."""
    table_pixels: int
    """Number of pixels on the table, in all poses."""
    distance_m: float
    """Median depth of the table, metres."""
    focal_baseline_px_m: float | None
    """Product of focal length and baseline, pixels times metres; None if it is unknown."""
    temporal_m: float | None
    """Standard deviation of a pixel over the images of one pose, metres; None with one image per pose."""
    ripple_m: float
    """Standard deviation of the error that all images of a pose share, without the slow warp, metres."""
    locking_m: float
    """Amplitude of the part of the ripple that repeats with each disparity (pixel locking), metres; 0 if none."""
    rest_m: float
    """Standard deviation of the ripple without pixel locking, metres."""
    correlation_px: float | None
    """Distance along the rows at which the rest has half of its covariance, pixels; None if it is unknown."""
    correlation_rows_px: float | None
    """The same along the columns of the image, from row to row."""
    warp_m: float
    """Root mean square of the error that varies slowly over the image, without its linear part, metres."""
    hole_share: float
    """Share of the pixels within the table that are not measured."""
    flicker_share: float | None
    """Share of these pixels that are measured in only one of two consecutive images; None with one image per pose."""
    edge_hole_share: float | None
    """Share of the pixels within 8 pixels of the edge of an object that are not measured; None with few of them."""

    def in_pixels(self, error_m: float) -> float | None:
        """Return a depth error at `distance_m` in pixels of disparity, or None if focal length or baseline is unknown.

        Args:
            error_m: Depth error, metres.
        """
        if self.focal_baseline_px_m is None:
            return None
        return error_m * self.focal_baseline_px_m / self.distance_m**2

    def value_at(self, name: str, distance_m: float) -> float | None:
        """Return the value of a quantity, a depth error as it is at another distance; None if it is unknown.

        Args:
            name: One of `QUANTITY_NAMES`.
            distance_m: Distance, metres.
        """
        value: float | None = getattr(self, name)
        if value is None or name not in ERRORS_M:
            return value
        return value * (distance_m / self.distance_m) ** 2


QUANTITY_NAMES = {
    "temporal_m": "temporal noise",
    "ripple_m": "ripple",
    "locking_m": "pixel locking",
    "rest_m": "rest of the ripple",
    "correlation_px": "correlation length",
    "correlation_rows_px": "vertical correlation",
    "warp_m": "warp",
    "hole_share": "holes",
    "flicker_share": "flicker",
    "edge_hole_share": "holes at edges",
}
"""Names of the measured fields, for a person, in the order of reports."""
ERRORS_M = ("temporal_m", "ripple_m", "locking_m", "rest_m", "warp_m")
"""Fields that are depth errors."""
MAX_VALUE = 1e9
"""Largest value of a field of a document."""


def format_quantity(name: str, value: float) -> str:
    """Return a value of a profile with its unit, for a person.

    Args:
        name: One of `QUANTITY_NAMES`.
        value: Metres, pixels, or a share.
    """
    if name in ERRORS_M:
        return f"{1000 * value:.2f} mm"
    if name.endswith("_share"):
        return f"{100 * value:.1f} %"
    return f"{value:.1f} px"


def to_document(profile: DepthProfile) -> dict[str, Any]:
    """Return a profile as a JSON object. It also has the errors in pixels of disparity, which are not read back."""
    document: dict[str, Any] = asdict(profile)
    for name in ERRORS_M:
        error_m = document[name]
        error_px = None if error_m is None else profile.in_pixels(error_m)
        document[f"{name.removesuffix('_m')}_px"] = error_px
    return document


def from_document(document: object) -> DepthProfile:
    """Return the profile of a JSON object.

    Args:
        document: Object of `to_document`. Unknown members are ignored.

    Raises:
        ProfileError: A member is missing or not valid; the message names it.
    """
    if not isinstance(document, Mapping):
        raise ProfileError("a profile is a JSON object, as `pointchain camera-profile` writes it")
    hints = typing.get_type_hints(DepthProfile)
    values: dict[str, Any] = {}
    for member in fields(DepthProfile):
        if member.name not in document:
            raise ProfileError(f"the profile lacks {member.name}: write it again with `pointchain camera-profile`")
        values[member.name] = _checked(member.name, document[member.name], hints[member.name])
    return DepthProfile(**values)


def _checked(name: str, value: object, kind: Any) -> int | float | None:
    """Return the value of a member, as an int or float of zero or more, or None where that is allowed."""
    if value is None and isinstance(kind, types.UnionType):
        return None
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ProfileError(f"{name} is {value!r}; a number of zero or more is needed")
    if not 0 <= value <= MAX_VALUE:
        raise ProfileError(f"{name} is {value!r}; a number from 0 to {MAX_VALUE:g} is needed")
    if kind is not int:
        return float(value)
    if value != int(value):
        raise ProfileError(f"{name} is {value!r}; a whole number is needed")
    return int(value)
