"""Errors of bags."""

from collections.abc import Iterable

from cell.recording.errors import RecordingError, shown

MAX_NAMES = 30


class BagError(RecordingError):
    """A bag that cannot become a recording. The message says what to do."""

    slug = "bag"


def listed(names: Iterable[object]) -> str:
    """Return sorted names of a bag for a message."""
    ordered = sorted({shown(name) for name in names})
    if not ordered:
        return "none"
    more = f" and {len(ordered) - MAX_NAMES} more" if len(ordered) > MAX_NAMES else ""
    return ", ".join(ordered[:MAX_NAMES]) + more
