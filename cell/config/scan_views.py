"""How many viewpoints a scan visits: a number, or as many as are needed."""

from typing import Literal

Views = int | Literal["auto"]
"""Number of viewpoints, or `auto`: one ring of viewpoints, and the other ring only if something is doubtful."""
MIN_VIEWPOINTS, MAX_VIEWPOINTS = 1, 32
"""Limits of a number of viewpoints."""
VIEWS_NEEDED = f'a whole number from {MIN_VIEWPOINTS} to {MAX_VIEWPOINTS} or "auto" is needed'
"""Message about any other value."""
AUTO_VIEWPOINTS = 8
"""Number of viewpoints that `auto` plans."""


def parse_views(value: object) -> Views:
    """Return the number of viewpoints that a value gives, or `auto`.

    Args:
        value: A number, or text such as that of an environment variable.

    Raises:
        ValueError: The value is neither.
    """
    if value == "auto":
        return "auto"
    number = None
    if isinstance(value, str):
        number = int(value) if value.isascii() and value.isdigit() and len(value) < 10 else None
    elif isinstance(value, int | float) and not isinstance(value, bool) and float(value).is_integer():
        number = int(value)
    if number is None or not MIN_VIEWPOINTS <= number <= MAX_VIEWPOINTS:
        raise ValueError(VIEWS_NEEDED)
    return number


def count_viewpoints(views: Views) -> int:
    """Return the number of viewpoints to plan."""
    return AUTO_VIEWPOINTS if views == "auto" else views
