"""Whether an answer is one that the description of the API has."""

import json
from pathlib import Path
from typing import Any

import httpx2
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


def check_described(answer: httpx2.Response) -> None:
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
        check_declared(answer)


def check_declared(answer: httpx2.Response) -> None:
    """A refusal has a problem type that the operation declares for its status."""
    described = _operation(answer.request)["responses"]
    declared = described.get(str(answer.status_code)) or described["default"]
    name = slug(answer) or ""
    request = f"{answer.request.method} {answer.request.url.path} gave {answer.status_code} {name}"
    assert PROBLEM_TYPES[name].status is not None, request
    types = declared["content"][MEDIA_TYPE]["schema"]["properties"]["type"]["enum"]
    assert f"urn:pointchain:{name}" in types, f"{request}, which is not declared"
    problem = answer.json()
    for parameter, value in problem.get("parameters", {}).items():
        assert parameter in PROBLEM_TYPES[name].parameters, f"{request} with an undeclared parameter {parameter}"
        if isinstance(value, str):
            assert value in problem["detail"], f"{request}: the detail does not contain the {parameter} {value}"


def slug(answer: httpx2.Response) -> str | None:
    """Of the problem; None: the answer is none."""
    if answer.status_code < 400:
        return None
    return answer.json()["type"].removeprefix("urn:pointchain:")


def _operation(request: httpx2.Request) -> dict[str, Any]:
    operation = described_operation(request.method, request.url.path)
    assert operation is not None, f"{request.method} {request.url.path} is not described"
    return operation


def described_operation(method: str, path: str) -> dict[str, Any] | None:
    """Return the operation in the description of the API; None where there is none."""
    matching = (operation for name, form, operation in OPERATIONS if name == method and form.match(path))
    return next(matching, None)
