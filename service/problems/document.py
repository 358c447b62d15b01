"""Errors as `application/problem+json` (RFC 9457): every answer that is not a success has this shape."""

import math
import sqlite3
from typing import Any
from urllib.parse import quote

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from starlette.exceptions import HTTPException

from calibration.geometry.transforms import NotRigidError
from cell.devices import InvalidViewError
from cell.errors import CellError, TooEarlyError
from cell.recording.errors import RecordingError, RecordingTooLargeError
from recognition.errors import RecognitionError
from service.problems.problem_types import PROBLEM_TYPES
from service.security.middleware.headers import UNEXPECTED
from service.storage.data_folder import OutsideError
from service.storage.storage_errors import is_full, is_held

MEDIA_TYPE = "application/problem+json"

KEPT = "what was recorded, if anything was, is kept: a scan that has a recording can be worked out again"
"""Of a scan that came to no end of its own."""

TITLES = {slug: kind.title for slug, kind in PROBLEM_TYPES.items()}
"""Titles do not change from one occurrence to the next."""

DESCRIPTIONS: dict[int | str, str] = {
    404: "There is no such thing",
    409: "Not in this state",
    413: "The request is too large",
    422: "The request, or what it refers to, cannot be used",
    503: "Not now",
    507: "There is too little space on the disk",
}

CELL_STATUS = {
    "camera-unreachable": 503,
    "robot-unreachable": 503,
    "robot-lost": 503,
    "camera-lost": 503,
    "viewpoints-unreachable": 422,
}
"""What the cell refuses is a conflict with the state that it is in, 409, but for these."""

INPUT_ERRORS = (RecordingError, RecognitionError, NotRigidError, InvalidViewError)
"""Refusals of what somebody sent, each with a slug: the sender can act on them."""


class ProblemError(HTTPException):
    """A refusal by the service.

    An HTTPException, because FastAPI lets only those pass where a body is read.
    """

    def __init__(self, status: int, slug: str, detail: str, headers: dict[str, str] | None = None) -> None:
        super().__init__(status, detail, headers)
        self.slug = slug


def problem_document(status: int, slug: str, detail: str, instance: str | None = None, **more: Any) -> dict[str, Any]:
    """The problem as a JSON document; `more` are extension members."""
    title = TITLES.get(slug, slug.replace("-", " ").capitalize())
    document = {"type": f"urn:pointchain:{slug}", "title": title, "status": status, "detail": detail}
    if instance is not None:
        document["instance"] = instance
    return document | more


def why_ended(state: str, problem: dict[str, Any] | None) -> str:
    """What a log says behind the state in which something ended, which a stopped scan's problem has the name of."""
    if problem is None:
        return ""
    slug = problem["type"].removeprefix("urn:pointchain:")
    return f": {problem['detail']}" if slug == state else f": {slug}: {problem['detail']}"


def cell_problem(error: CellError) -> dict[str, Any]:
    """What the cell refuses, or broke off by, as a problem document."""
    return problem_document(CELL_STATUS.get(error.slug, 409), error.slug, str(error))


def stopped_problem(state: str, detail: str) -> dict[str, Any]:
    """What ended because somebody stopped it, `aborted`, or because the service did, `interrupted`."""
    return problem_document(409 if state == "aborted" else 500, state, detail)


def storage_problem(error: Exception, kept: str) -> dict[str, Any] | None:
    """A scan or calibration that ended because the disk is full or the database is held; `kept` says what is kept of
    it. None: that is not why."""
    if is_full(error):
        return problem_document(507, "storage-full", f"no space is left in the data folder; {kept}")
    if is_held(error):
        return problem_document(503, "busy", f"another program held the database for too long; {kept}")
    return None


def problem_responses(*statuses: int) -> dict[int | str, dict[str, Any]]:
    """What an operation declares of its refusals, for the API's description; any other is a problem too."""
    content = {MEDIA_TYPE: {"schema": {"$ref": "#/components/schemas/Problem"}}}
    return {
        status: {"description": DESCRIPTIONS.get(status, "Any other problem"), "content": content}
        for status in (*statuses, "default")
    }


def install_problem_handlers(app: FastAPI) -> None:
    """Makes every error of `app` a problem document."""

    def respond(
        request: Request,
        status: int,
        slug: str,
        detail: str,
        headers: dict[str, str] | None = None,
        **more: Any,
    ) -> JSONResponse:
        request.state.problem = slug  # for the audit log
        document = problem_document(status, slug, detail, quote(request.url.path), **more)
        return JSONResponse(document, status, headers=headers, media_type=MEDIA_TYPE)

    @app.exception_handler(ProblemError)
    async def _problem(request: Request, error: ProblemError) -> JSONResponse:
        return respond(request, error.status_code, error.slug, error.detail, dict(error.headers or {}))

    @app.exception_handler(HTTPException)
    async def _http(request: Request, error: HTTPException) -> JSONResponse:
        slug, detail = {
            400: ("bad-request", error.detail),
            404: ("not-found", "there is nothing at this address; /docs lists what there is"),
            405: ("method-not-allowed", f"{request.method} is not possible here"),
        }.get(error.status_code, ("http-error", error.detail))
        return respond(request, error.status_code, slug, str(detail), dict(error.headers or {}))

    @app.exception_handler(RequestValidationError)
    async def _invalid(request: Request, error: RequestValidationError) -> JSONResponse:
        # The input itself is left out: it may be huge, or NaN, which JSON cannot say.
        errors = [
            {"where": ".".join(str(part) for part in item["loc"]), "what": item["msg"]} for item in error.errors()
        ]
        detail = "; ".join(f"{item['where']}: {item['what']}" for item in errors[:5])
        kind = request.headers.get("content-type", "application/json")
        if "json" not in kind and any(item["where"] == "body" for item in errors):
            detail += f"; its Content-Type is {kind[:80]}, which is not read: send application/json"
        return respond(request, 422, "invalid-request", detail, errors=errors[:50])

    async def _input(request: Request, error: Exception) -> JSONResponse:
        assert isinstance(error, INPUT_ERRORS)
        status = 413 if isinstance(error, RecordingTooLargeError) else 422
        return respond(request, status, error.slug, str(error))

    @app.exception_handler(CellError)
    async def _cell(request: Request, error: CellError) -> JSONResponse:
        again = {"Retry-After": str(math.ceil(error.wait_s))} if isinstance(error, TooEarlyError) else None
        return respond(request, CELL_STATUS.get(error.slug, 409), error.slug, str(error), again)

    @app.exception_handler(OutsideError)
    async def _outside(request: Request, error: OutsideError) -> JSONResponse:
        return respond(request, 403, error.slug, str(error))

    for kind in INPUT_ERRORS:
        app.add_exception_handler(kind, _input)

    @app.exception_handler(sqlite3.OperationalError)
    async def _database(request: Request, error: sqlite3.OperationalError) -> JSONResponse:
        if is_full(error):
            return _storage_full(request)
        if is_held(error):
            again = {"Retry-After": "5"}
            return respond(request, 503, "busy", "another program holds the database; try again", again)
        raise error

    @app.exception_handler(OSError)
    async def _system(request: Request, error: OSError) -> JSONResponse:
        if is_full(error):
            return _storage_full(request)
        raise error

    def _storage_full(request: Request) -> JSONResponse:
        return respond(request, 507, "storage-full", "no space is left in the data folder; free some")

    @app.exception_handler(Exception)
    async def _unexpected(request: Request, error: Exception) -> JSONResponse:
        # Starlette raises the error again after this answer, so the server's log has the traceback.
        return respond(request, 500, "internal", "unexpected error; the service's log has it", dict(UNEXPECTED))
