"""Check answers against the OpenAPI document."""

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
    """Check that the document has the status and content type of an answer, and the problem type of a refusal."""
    request = f"{answer.request.method} {answer.request.url.path} gave {answer.status_code}"
    described = _operation(answer.request)["responses"]
    response = described.get(str(answer.status_code))
    if response is None:
        assert answer.status_code >= 400, f"{request}, which is not described"
        response = described["default"]
        assert answer.status_code < 500, f"{request}, which is not described: {answer.text}"
    content = answer.headers.get("content-type", "").partition(";")[0]
    assert content in response.get("content", {"": {}}), f"{request} as {content!r}"
    if answer.status_code >= 400:
        assert content == MEDIA_TYPE, request
        check_declared(answer)


def check_declared(answer: httpx2.Response) -> None:
    """Check that the operation declares the problem type of a refusal for its status."""
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
    """Return the slug of the problem, or None if the answer is not a problem."""
    if answer.status_code < 400:
        return None
    return answer.json()["type"].removeprefix("urn:pointchain:")


def _operation(request: httpx2.Request) -> dict[str, Any]:
    operation = described_operation(request.method, request.url.path)
    assert operation is not None, f"{request.method} {request.url.path} is not described"
    return operation


def described_operation(method: str, path: str) -> dict[str, Any] | None:
    """Return the operation in the OpenAPI document, or None if it has none."""
    matching = (operation for name, form, operation in OPERATIONS if name == method and form.match(path))
    return next(matching, None)
