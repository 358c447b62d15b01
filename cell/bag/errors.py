"""What is refused of a bag."""

from collections.abc import Iterable

from cell.recording_errors import RecordingError

MOST_NAMES = 30
MOST_CHARACTERS = 100


class BagError(RecordingError):
    """A bag of which no recording can be made; the message says what to do."""

    slug = "bag"


def shown(name: object) -> str:
    """A name out of a bag, which may hold anything, as it can go to a terminal."""
    text = "".join(c if c.isprintable() else "?" for c in str(name)[: MOST_CHARACTERS + 1])
    return text if len(text) <= MOST_CHARACTERS else f"{text[:MOST_CHARACTERS]}..."


def listed(names: Iterable[object]) -> str:
    """Names out of a bag in order, one after the other."""
    ordered = sorted({shown(name) for name in names})
    if not ordered:
        return "none"
    more = f" and {len(ordered) - MOST_NAMES} more" if len(ordered) > MOST_NAMES else ""
    return ", ".join(ordered[:MOST_NAMES]) + more
