"""Base of all settings: a mistyped key or an impossible value is rejected with its name."""

import math
import re

from pydantic import BaseModel, ConfigDict

Range = tuple[float, float]
Vector3 = tuple[float, float, float]
Vector6 = tuple[float, float, float, float, float, float]


class StrictSettings(BaseModel):
    """A frozen model without unknown keys. Every number is finite."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


OTHER_UNIT_FACTOR = 3.0
"""Factor by which a value must exceed its limits to count as given in another unit."""


def unit_hint(name: str, value: float, low: float, high: float) -> str:
    """Return a hint if a value beyond its limits looks like millimetres or degrees, or an empty text.

    Args:
        name: Name of the setting, which ends with its unit, as `top_m` or `speed_rad_s`.
        value: The value that was refused.
        low: Smallest value that is taken.
        high: Largest value that is taken.
    """
    unit = re.search(r"_(m|rad)(_s2?)?$", name)
    if unit is None or not abs(value) >= OTHER_UNIT_FACTOR * max(abs(low), abs(high)):
        return ""
    expected, other, factor = {
        "m": ("metres", "millimetres", 0.001),
        "rad": ("radians", "degrees", math.pi / 180),
    }[unit[1]]
    if not low <= value * factor <= high:
        return ""
    per = {None: "", "_s": " per second", "_s2": " per second squared"}[unit[2]]
    return f"; {expected}{per} are expected, and {value:g} looks like {other}{per}"
