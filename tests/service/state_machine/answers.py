"""Whether an answer is one that the description of the API has."""

import json
from pathlib import Path
from typing import Any

import httpx
from starlette.routing import compile_path

import service
from service.problems.document import MEDIA_TYPE
from service.problems.problem_types import PROBLEM_TYPES

DESCRIPTION = json.loads((Path(service.__file__).parent / "openapi.json").read_text())
OPERATIONS = [
    (method.upper(), compile_path(path)[0], operation)
    for path, item in DESCRIPTION["paths"].items()
    for method, operation in item.items()
]


def check_described(answer: httpx.Response) -> None:
    """Its status and content are described, and a refusal is a problem of a type that we know."""
    request = f"{answer.request.method} {answer.request.url.path} gave {answer.status_code}"
    described = _operation(answer.request)["responses"]
    told = described.get(str(answer.status_code))
    if told is None:
        assert answer.status_code >= 400, f"{request}, which is not described"
        told = described["default"]
        assert answer.status_code < 500, f"{request}, which is not described: {answer.text}"
    content = answer.headers.get("content-type", "").partition(";")[0]
    assert content in told.get("content", {"": {}}), f"{request} as {content!r}"
    if answer.status_code >= 400:
        assert content == MEDIA_TYPE, request
        name = slug(answer) or ""
        assert name in PROBLEM_TYPES, f"{request}: {answer.text}"
        assert PROBLEM_TYPES[name].statuses, f"{request}: {answer.text}"


def slug(answer: httpx.Response) -> str | None:
    """Of the problem; None: the answer is none."""
    if answer.status_code < 400:
        return None
    return answer.json()["type"].removeprefix("urn:pointchain:")


def _operation(request: httpx.Request) -> dict[str, Any]:
    for method, path, operation in OPERATIONS:
        if method == request.method and path.match(request.url.path):
            return operation
    raise AssertionError(f"{request.method} {request.url.path} is not described")
