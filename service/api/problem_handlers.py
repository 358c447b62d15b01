"""Exception handlers that turn every error of a request into a problem document."""

import math
import sqlite3
import sys
from collections.abc import Mapping
from typing import Any
from urllib.parse import quote

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from starlette.exceptions import HTTPException

from cell.errors import CellError, TooEarlyError
from service.api.schemas.addresses import job_address
from service.errors import INPUT_ERRORS, ServiceError
from service.problems.document import MEDIA_TYPE, problem_document
from service.problems.problem_error import ProblemError
from service.security.middleware.headers import UNEXPECTED_ERROR_HEADERS
from service.storage.data_folder import OutsideError
from service.storage.storage_errors import is_full, is_locked

_SCAN_MODES = {"live": "a scan by the arm", "replay": "a scan from a recording"}
"""Values of the member `mode`, which decides between the forms of a request for a scan."""
_FORMS = frozenset({*_SCAN_MODES, "token", "code"})
"""Names of the forms of the requests that have several: those for a scan, and those to sign in."""


def install_problem_handlers(app: FastAPI) -> None:
    """Make every error of `app` a problem document."""
    app.add_exception_handler(ProblemError, _on_problem)
    app.add_exception_handler(ServiceError, _on_service_error)
    app.add_exception_handler(HTTPException, _on_http_exception)
    app.add_exception_handler(RequestValidationError, _on_invalid_request)
    app.add_exception_handler(CellError, _on_cell_error)
    for kind in (*INPUT_ERRORS, OutsideError):
        app.add_exception_handler(kind, _on_error_with_slug)
    app.add_exception_handler(sqlite3.OperationalError, _on_storage_error)
    app.add_exception_handler(OSError, _on_storage_error)
    app.add_exception_handler(Exception, _on_unexpected_error)


def _respond(
    request: Request, slug: str, detail: str, headers: dict[str, str] | None = None, **more: Any
) -> JSONResponse:
    request.state.problem = slug  # for the audit log
    document = problem_document(slug, detail, quote(request.url.path), **more)
    return JSONResponse(document, document["status"], headers=headers, media_type=MEDIA_TYPE)


async def _on_problem(request: Request, error: Exception) -> JSONResponse:
    assert isinstance(error, ProblemError)
    return _respond(request, error.slug, error.detail, dict(error.headers or {}), parameters=error.parameters)


async def _on_service_error(request: Request, error: Exception) -> JSONResponse:
    assert isinstance(error, ServiceError)
    headers = _retry_after(error.retry_after_s)
    if error.job is not None:
        headers["Location"] = job_address(error.job)
    return _respond(request, error.slug, str(error), headers, parameters=error.parameters)


async def _on_http_exception(request: Request, error: Exception) -> JSONResponse:
    assert isinstance(error, HTTPException)
    headers = dict(error.headers or {})
    if error.status_code == 400:
        return _respond(request, "bad-request", _why_unreadable(error), headers)
    if error.status_code == 404:
        return _respond(request, "not-found", "there is nothing at this address; /docs lists what there is", headers)
    if error.status_code == 405:
        detail = f"{request.method} is not possible here"
        return _respond(request, "method-not-allowed", detail, headers, parameters={"method": request.method})
    return _respond(request, "http-error", str(error.detail), headers)


def _why_unreadable(error: HTTPException) -> str:
    """Return why a body cannot be read. FastAPI has only the exception as a reason."""
    match error.__cause__:
        case RecursionError():
            return "the body has too many lists or objects inside one another"
        case UnicodeDecodeError() as cause:
            return f"the body is not UTF-8, as JSON must be (RFC 8259): {cause.reason} at byte {cause.start}"
        case ValueError() as cause if "digits" in str(cause):
            return f"the body has an integer of more than {sys.get_int_max_str_digits()} digits"
    return str(error.detail)


async def _on_invalid_request(request: Request, error: Exception) -> JSONResponse:
    assert isinstance(error, RequestValidationError)
    # The input itself is not repeated: it may be huge, or NaN, which JSON cannot represent.
    errors = [_describe_invalid(item) for item in error.errors()]
    detail = "; ".join(f"{item['where']}: {item['what']}" for item in errors[:5])
    kind = request.headers.get("content-type", "application/json")
    if "json" not in kind and any(item["where"] == "body" for item in errors):
        detail += f"; its Content-Type is {kind[:80]}, which is not read: send application/json"
    return _respond(request, "invalid-request", detail, errors=errors[:50])


def _describe_invalid(error: Mapping[str, Any]) -> dict[str, str]:
    """Return the place of an error in a request, and a message that does not need knowledge of Pydantic."""
    place = [str(part) for part in error["loc"]]
    if place[0] == "body" and place[1:2] and place[1] in _FORMS:
        del place[1]  # Pydantic names the form of the request here. The body has no such member.
    where = ".".join(place)
    possible = " or ".join(f'"{mode}" for {meaning}' for mode, meaning in _SCAN_MODES.items())
    match error.get("type"):
        case "union_tag_not_found":
            member = error["ctx"]["discriminator"].strip("'")
            return {"where": f"{where}.{member}", "what": f"it is missing: give {possible}"}
        case "union_tag_invalid":
            member, tag = error["ctx"]["discriminator"].strip("'"), str(error["ctx"]["tag"])[:40]
            return {"where": f"{where}.{member}", "what": f"{tag!r} is not possible: give {possible}"}
        case "missing":
            return {"where": where, "what": "it is missing"}
        case "extra_forbidden" if place == ["body", "recording"]:
            return {"where": where, "what": "only a scan with the mode replay has a recording"}
        case "extra_forbidden" if place == ["body", "views"]:
            return {"where": where, "what": "only a scan with the mode live has a number of views"}
        case "extra_forbidden":
            return {"where": where, "what": "there is no such member"}
        case "json_invalid":
            return {"where": "body", "what": f"not JSON: {error['ctx']['error']} at character {place[-1]}"}
        case "value_error":
            return {"where": where, "what": str(error["ctx"]["error"])}
        case "float_type":
            return {"where": where, "what": "a number is needed"}
        case "bool_type":
            return {"where": where, "what": "true or false is needed"}
        case "model_attributes_type" | "model_type" | "dict_type":
            return {"where": where, "what": "a JSON object is needed"}
    return {"where": where, "what": error["msg"]}


async def _on_cell_error(request: Request, error: Exception) -> JSONResponse:
    assert isinstance(error, CellError)
    headers = _retry_after(error.wait_s if isinstance(error, TooEarlyError) else None)
    return _respond(request, error.slug, str(error), headers)


async def _on_error_with_slug(request: Request, error: Exception) -> JSONResponse:
    assert isinstance(error, (*INPUT_ERRORS, OutsideError))
    return _respond(request, error.slug, str(error))


async def _on_storage_error(request: Request, error: Exception) -> JSONResponse:
    if is_full(error):
        return _respond(request, "storage-full", "no space is left in the data folder; free some")
    if is_locked(error):
        return _respond(request, "busy", "another program has locked the database; try again", _retry_after(5.0))
    raise error


async def _on_unexpected_error(request: Request, error: Exception) -> JSONResponse:
    # Starlette raises the error again after this answer, so the server's log has the traceback.
    return _respond(request, "internal", "unexpected error; the service's log has it", dict(UNEXPECTED_ERROR_HEADERS))


def _retry_after(seconds: float | None) -> dict[str, str]:
    return {} if seconds is None else {"Retry-After": str(math.ceil(seconds))}
