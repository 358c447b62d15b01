"""What is refused of a bag."""

from collections.abc import Iterable

from cell.recording.errors import RecordingError, shown

MOST_NAMES = 30


class BagError(RecordingError):
    """A bag of which no recording can be made; the message says what to do."""

    slug = "bag"


def listed(names: Iterable[object]) -> str:
    """Names out of a bag in order, one after the other."""
    ordered = sorted({shown(name) for name in names})
    if not ordered:
        return "none"
    more = f" and {len(ordered) - MOST_NAMES} more" if len(ordered) > MOST_NAMES else ""
    return ", ".join(ordered[:MOST_NAMES]) + more
