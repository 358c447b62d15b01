"""Compare the measured profile of a camera with those of a simulated camera of the same kind."""

from collections.abc import Sequence
from dataclasses import dataclass

from cell.camera_profile.depth_profile import ERRORS_M, QUANTITY_NAMES, DepthProfile

TEXTURE = "give the table more texture, or switch the dots on with camera.ir_dots"
LIGHT = "add light or set a longer camera.exposure_us; more texture, or dots by camera.ir_dots, help too"


@dataclass(frozen=True)
class Quantity:
    """A quantity of a profile that is compared."""

    field: str
    """Field of `DepthProfile`."""
    factor: float
    """Largest ratio to the largest expected value."""
    margin: float
    """Excess over the largest expected value that does not count, in disparities for a depth error, else as it is."""
    advice: str
    """What to do if it is larger."""

    @property
    def name(self) -> str:
        """Name in messages."""
        return QUANTITY_NAMES[self.field]


QUANTITIES = (
    Quantity("temporal_m", 1.5, 0.05, LIGHT),
    Quantity("ripple_m", 1.4, 0.04, TEXTURE),
    Quantity("locking_m", 1.4, 0.05, "switch the subpixel mode of the camera on"),
    Quantity("rest_m", 1.5, 0.04, TEXTURE),
    Quantity("correlation_px", 1.5, 1.0, "switch the filters of the depth off"),
    Quantity("warp_m", 1.8, 0.1, "check that the table is flat; calibrate the camera with the vendor's tool"),
    Quantity("hole_share", 1.5, 0.03, TEXTURE),
    Quantity("flicker_share", 1.5, 0.01, TEXTURE),
)
"""Quantities, in the order of the report. The limits exceed the differences between simulated devices of one kind."""


@dataclass(frozen=True)
class Compared:
    """A quantity, measured and expected."""

    quantity: Quantity
    measured: float
    """Measured value, metres at the distance of the measured profile, pixels or a share."""
    low: float
    """Smallest expected value."""
    high: float
    """Largest expected value."""
    limit: float
    """Largest value with which the stated accuracy may be expected."""

    @property
    def is_good(self) -> bool:
        """Whether the value is within the limit."""
        return self.measured <= self.limit


def compare(measured: DepthProfile, expected: Sequence[DepthProfile]) -> list[Compared]:
    """Return all quantities that were measured and are expected.

    Args:
        measured: Profile of a camera.
        expected: Profiles of simulated cameras on tables with which the accuracy is stated.
    """
    compared = []
    for quantity in QUANTITIES:
        value = getattr(measured, quantity.field)
        others = [profile.value_at(quantity.field, measured.distance_m) for profile in expected]
        known = [other for other in others if other is not None]
        if value is None or not known:
            continue
        limit = max(known) * quantity.factor + _margin(measured, expected, quantity)
        compared.append(Compared(quantity, value, min(known), max(known), limit))
    return compared


def _margin(measured: DepthProfile, expected: Sequence[DepthProfile], quantity: Quantity) -> float:
    """Return the excess that does not count, in the unit of the value."""
    if quantity.field not in ERRORS_M:
        return quantity.margin
    focal_baselines = [profile.focal_baseline_px_m for profile in (*expected, measured)]
    known = [value for value in focal_baselines if value is not None]
    if not known:
        return 0.0
    return quantity.margin * measured.distance_m**2 / known[0]
