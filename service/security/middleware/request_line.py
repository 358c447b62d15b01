"""What a request asks for, as logs tell it."""

import re
from urllib.parse import quote

from starlette.types import Message, Scope

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


def scan_of(scope: Scope, answer: Message) -> str | None:
    """Id of the scan that a request was about, once its answer begins: the one that it has started, which is its
    Location, or has stopped; else the one that its address names."""
    if answer["status"] < 300:  # a refusal's Location is of what is in the way
        started = scan_in(header_of(answer, b"location"))
        about = started or scope.get("state", {}).get("stopped_scan")
        if about is not None:
            return about
    return scan_in(scope["path"])


def header_of(answer: Message, name: bytes) -> str:
    """A header of an answer that begins, given in small letters; empty: it has none."""
    return next((value.decode("latin-1") for key, value in answer.get("headers", ()) if key.lower() == name), "")
