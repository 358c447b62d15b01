"""The problems that each operation declares in `openapi.json`."""

from collections import defaultdict
from typing import Any

from service.problems.document import MEDIA_TYPE, PREFIX
from service.problems.problem_types import PROBLEM_TYPES

DESCRIPTIONS = {
    400: "The request is malformed",
    401: "A token is needed",
    404: "There is no such thing",
    409: "Not in this state",
    413: "The request is too large",
    422: "The request, or what it refers to, cannot be used",
    429: "Too many attempts",
    503: "Not now",
    507: "There is too little space on the disk",
}
"""Descriptions of the statuses that operations declare."""

ANY_REQUEST = (
    "bad-request", "busy", "cross-origin", "damaged", "encoded-body", "forbidden", "headers-too-large",
    "host-not-allowed", "http-error", "internal", "invalid-request", "not-ready", "outside-data-folder", "storage-full",
    "target-too-long", "token-in-query", "too-large", "too-slow", "unauthorized",
)  # fmt: skip
"""Problems that any request can have: the checks before each route, the disk and the database."""

CELL = (
    "acknowledge-required", "bad-frame", "calibration", "camera-lost", "camera-unreachable", "cell", "cell-busy",
    "config", "emergency-stop", "motion-failed", "protective-stop", "robot-lost", "robot-not-ready",
    "robot-unreachable", "stopped",
)  # fmt: skip
"""Problems of an operation that connects or needs arm and camera."""

RECORDING = (
    "duplicate-view", "invalid-view", "not-mcap", "not-rigid", "recording-content", "recording-corrupt",
    "recording-empty", "recording-header", "recording-refused", "recording-unreadable",
)  # fmt: skip
"""Problems of an operation that reads a recording."""


def problem_responses(*slugs: str) -> dict[int | str, dict[str, Any]]:
    """Return the `responses` of an operation for the problems that it can answer with.

    Those of `ANY_REQUEST` are added: to the statuses that the operation has already, and else to `default`.

    Args:
        slugs: Types of the operation's own problems.
    """
    by_status: dict[int, list[str]] = defaultdict(list)
    for slug in slugs:
        by_status[_status(slug)].append(slug)
    rest: list[str] = []
    for slug in ANY_REQUEST:
        by_status.get(_status(slug), rest).append(slug)
    responses: dict[int | str, dict[str, Any]] = {
        status: _response(DESCRIPTIONS[status], by_status[status]) for status in sorted(by_status)
    }
    return responses | {"default": _response("Any other problem", rest)}


def _status(slug: str) -> int:
    status = PROBLEM_TYPES[slug].status
    assert status is not None, f"{slug} has no HTTP status"
    return status


def _response(description: str, slugs: list[str]) -> dict[str, Any]:
    types = [f"{PREFIX}{slug}" for slug in sorted(set(slugs))]
    schema = {
        "allOf": [{"$ref": "#/components/schemas/Problem"}],
        "properties": {"type": {"enum": types}},
    }
    return {"description": description, "content": {MEDIA_TYPE: {"schema": schema}}}
