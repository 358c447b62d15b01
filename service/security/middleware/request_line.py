"""The path of a request, and the scan that the request is about, for the logs."""

import re
from urllib.parse import quote

from starlette.types import Message, Scope

MAX_PATH_CHARS = 200
"""Maximum length of a logged path."""
_SCAN = re.compile(r"/api/scans/([0-9a-z-]{1,64})(?:/|$)")


def printable_path(path: str) -> str:
    """Return the path as one line of plain text. The query string, which may contain a token, is not part of it."""
    return quote(path)[:MAX_PATH_CHARS]


def scan_id_in_path(path: str) -> str | None:
    """Return the id of the scan in a path, or None."""
    found = _SCAN.match(path)
    return None if found is None else found[1]


def scan_id_of_request(scope: Scope, answer: Message) -> str | None:
    """Return the id of the scan that a request is about, or None.

    It is the scan that the request has started, which the header Location names, or stopped; else the scan in the path.

    Args:
        scope: Scope of the request.
        answer: Message that begins the answer.
    """
    if answer["status"] < 300:  # the Location of a refusal names the scan that blocks the request
        started = scan_id_in_path(response_header(answer, b"location"))
        scan_id = started or scope.get("state", {}).get("stopped_scan")
        if scan_id is not None:
            return scan_id
    return scan_id_in_path(scope["path"])


def response_header(answer: Message, name: bytes) -> str:
    """Return a header of an answer, or an empty string.

    Args:
        answer: Message that begins the answer.
        name: Name of the header in lower case.
    """
    return next((value.decode("latin-1") for key, value in answer.get("headers", ()) if key.lower() == name), "")
