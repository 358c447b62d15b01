"""The OpenAPI document is committed, complete and consistent, and its page works without the internet."""

import json
import re
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import httpx2
import pytest
from openapi_spec_validator import OpenAPIV31SpecValidator, validate

import service
from service.app import create_app, openapi_document
from service.config.loader import ServiceConfig
from service.problems.problem_types import PROBLEM_TYPES
from tests.service.conftest import PATIENCE_S, Serve
from tests.service.security.conftest import without_recognition

COMMITTED = Path(service.__file__).parent / "openapi.json"
ALL_PROBLEMS = set(json.loads(COMMITTED.read_text())["components"]["schemas"]["Problem"]["properties"]["type"]["enum"])


def operations() -> list[tuple[str, str, dict[str, Any]]]:
    paths = create_app(ServiceConfig()).openapi()["paths"]
    return [(path, method, operation) for path, item in paths.items() for method, operation in item.items()]


def test_the_committed_document_is_up_to_date() -> None:
    assert json.loads(COMMITTED.read_text()) == json.loads(openapi_document()), (
        "the API has changed: check the difference, then run `python -m service.app > service/openapi.json`"
    )


def test_the_document_is_valid() -> None:
    document = json.loads(COMMITTED.read_text())
    assert document["openapi"] == "3.1.0"  # generators of clients are not at 3.2 yet
    validate(document, cls=OpenAPIV31SpecValidator)


def test_generators_of_clients_can_read_the_document() -> None:
    for schema in objects(json.loads(COMMITTED.read_text())):
        for choice in schema.get("anyOf", ()):
            assert "const" not in choice  # openapi-python-client would refuse the other alternatives
        match schema:
            case {"items": {"items": dict(entry)}}:
                assert (
                    "enum" not in entry
                )  # of OpenAPI Generator's Python client, each row would have to be such a value
    for path, method, operation in operations():
        for content in operation.get("requestBody", {}).get("content", {}).values():
            assert "oneOf" not in content["schema"]  # without a name, the type that oapi-codegen makes sends {}
        for answer in operation["responses"].values():
            for link in answer.get("links", {}).values():
                assert isinstance(link.get("requestBody", ""), str), f"{method} {path}"  # its parser takes nothing else


def objects(node: Any) -> Iterator[dict[str, Any]]:
    """Yield each object in a JSON document."""
    if isinstance(node, dict):
        yield node
    for child in node.values() if isinstance(node, dict) else node if isinstance(node, list) else ():
        yield from objects(child)


@pytest.mark.parametrize(("path", "method", "operation"), operations())
def test_every_operation_describes_its_success_and_its_problems(
    path: str, method: str, operation: dict[str, Any]
) -> None:
    assert operation["description"]
    responses = operation["responses"]
    refusals = {status: answer for status, answer in responses.items() if not status.startswith(("2", "3"))}
    assert "default" in refusals
    media_type = "application/problem+json"
    declared: dict[str, set[str]] = {}
    for status, answer in refusals.items():
        assert list(answer["content"]) == [media_type]
        schema = answer["content"][media_type]["schema"]
        assert schema["allOf"] == [{"$ref": "#/components/schemas/Problem"}]
        declared[status] = {name.removeprefix("urn:pointchain:") for name in schema["properties"]["type"]["enum"]}
        assert {f"urn:pointchain:{name}" for name in declared[status]} <= ALL_PROBLEMS
    # each problem type is declared once, for its own status or without one
    for status, names in declared.items():
        statuses = {str(PROBLEM_TYPES[name].status) for name in names}
        assert statuses.isdisjoint(declared) if status == "default" else statuses == {status}
    # an operation with an input can refuse it; any other declares 422 only for problems of its own
    has_input = bool(operation.get("parameters") or operation.get("requestBody"))
    assert ("422" in refusals) == (has_input or bool(declared.get("422", set()) - {"invalid-request"}))
    successes = [answer for status, answer in responses.items() if status.startswith("2") and status != "204"]
    if path == "/api/scans/{id}" and method == "delete":
        assert (successes, "204" in responses) == ([], True)
        return
    assert len(successes) == (2 if "validate_only" in operation["description"] else 1)
    for success in successes:
        (content,) = success["content"].values()
        assert content["schema"], f"{method} {path} has no schema for its answer"


def test_the_page_of_the_api_needs_no_other_host(client: httpx2.Client) -> None:
    page = client.get("/docs").text
    assert not re.findall(r"""(?:src|href)\s*=\s*["'](?:https?:)?//""", page)
    assets = [a for a in re.findall(r"""(?:src|href)\s*=\s*["']([^"']+)["']""", page) if not a.startswith("data:")]
    assert len(assets) >= 3
    for asset in assets:
        assert client.get(asset).status_code == 200, asset
    assert client.get("/openapi.json").json() == json.loads(COMMITTED.read_text())


def test_no_request_waits_while_the_document_is_generated(
    serve: Serve, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    making, go_on = threading.Event(), threading.Event()

    def make() -> dict[str, Any]:
        making.set()
        assert go_on.wait(PATIENCE_S)
        return {"made": "at last"}

    # a service of its own, because the answer that is made here stays in its cache
    with without_recognition(serve, tmp_path) as client, ThreadPoolExecutor(1) as pool:
        monkeypatch.setattr(client.app, "openapi", make)
        pending = pool.submit(client.get, "/openapi.json")
        try:
            assert making.wait(PATIENCE_S)
            assert client.get("/healthz").status_code == 200
            assert client.post("/api/cell/stop").status_code == 200
        finally:
            go_on.set()
        assert pending.result().json() == {"made": "at last"}
