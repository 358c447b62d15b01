"""What a request asks for, as logs tell it."""

import re
from urllib.parse import quote

MOST_PATH = 200
"""So much of an address is told."""
_SCAN = re.compile(r"/api/scans/([0-9a-z-]{1,64})(?:/|$)")


def shown_path(path: str) -> str:
    """The address as one plain line, without the query string, where somebody may have put a token."""
    return quote(path)[:MOST_PATH]


def scan_in(path: str) -> str | None:
    """Id of the scan that the address names, if any."""
    found = _SCAN.match(path)
    return None if found is None else found[1]
