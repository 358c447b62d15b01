"""Each operation has recorded examples, which match its schemas, and the recorder shortens lists consistently."""

import json
import re
from typing import Any

import pytest
from jsonschema import Draft202012Validator

from service.api.examples import EXAMPLES_FILE, read_examples
from service.app import create_app
from service.config.loader import ServiceConfig
from service.problems.document import MEDIA_TYPE as PROBLEM
from tests.service.api.record_examples import shorten

DOCUMENT = create_app(ServiceConfig()).openapi()
OPERATIONS = {operation["operationId"]: operation for item in DOCUMENT["paths"].values() for operation in item.values()}
JSON, EVENTS = "application/json", "text/event-stream"
EVENT_SCHEMAS = {"scan": "ScanResource"}
"""Schema of the data of an event, by the event's name."""


def contents(operation: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """Return the content of the request and of each response by media type."""
    requests = {"request": operation["requestBody"]} if "requestBody" in operation else {}
    return {name: one.get("content", {}) for name, one in (requests | operation["responses"]).items()}


def check_schema(schema: dict[str, Any], value: Any) -> None:
    errors = [
        f"{error.json_path}: {error.message}"
        for error in Draft202012Validator(schema | {"components": DOCUMENT["components"]}).iter_errors(value)
    ]
    assert errors == []


def check_events(schema: dict[str, Any], text: str) -> None:
    """Check a text of server-sent events: the schema of each event, and that of its data if it has one."""
    *events, rest = text.split("\n\n")
    assert events
    assert rest == ""
    for lines in events:
        event = dict(line.split(": ", 1) for line in lines.splitlines())
        check_schema(schema, event)
        data = json.loads(event["data"])
        if event["event"] in EVENT_SCHEMAS:
            check_schema({"$ref": f"#/components/schemas/{EVENT_SCHEMAS[event['event']]}"}, data)


@pytest.mark.parametrize("name", OPERATIONS)
def test_each_operation_has_examples_that_match_its_schemas(name: str) -> None:
    for part, by_media_type in contents(OPERATIONS[name]).items():
        for media_type, content in by_media_type.items():
            examples = content.get("examples", {})
            if part.startswith(("request", "2")) and media_type in (JSON, EVENTS):
                assert examples, f"{name} {part} has no example; CONTRIBUTING.md names the command that records them"
            for example, members in examples.items():
                assert members["summary"], example
                if media_type == EVENTS:
                    check_events(content["x-itemSchema"], members["value"])
                elif media_type in (JSON, PROBLEM):
                    check_schema(content["schema"], members["value"])


def test_the_examples_are_of_described_requests_and_answers() -> None:
    for name, examples in read_examples().items():
        assert name in OPERATIONS
        described = contents(OPERATIONS[name])
        recorded = examples.get("responses", {}) | {key: examples[key] for key in ("request",) if key in examples}
        assert set(recorded) <= set(described), name
        for part, by_name in recorded.items():
            (content,) = described[part].values()
            assert content["examples"] == by_name, f"{name} {part}"


def test_a_scan_has_an_example_of_each_kind() -> None:
    body = OPERATIONS["start_scan"]["requestBody"]["content"][JSON]
    requests = [example["value"] for example in body["examples"].values()]
    assert {request["mode"] for request in requests} == {"live", "replay"}
    assert any("string_radius_m" in request for request in requests)


def test_the_examples_contain_no_secret_and_no_path_of_a_machine() -> None:
    text = EXAMPLES_FILE.read_text()
    assert not re.findall(r"pct_\w+|\"/(?!api/|readyz|healthz)[^\"]*", text)
    assert not re.findall(r"127\.\d+\.\d+\.\d+|localhost", text)


def test_parallel_lists_are_shortened_at_the_same_elements() -> None:
    points = [[float(index), 0.0, 0.0] for index in range(142)]
    short = shorten({"points": points, "arc_length_m": [float(index) for index in range(142)], "matrix": [[1] * 6] * 6})
    assert [point[0] for point in short["points"]] == short["arc_length_m"]
    assert (short["arc_length_m"][0], short["arc_length_m"][-1]) == (0.0, 141.0)
    assert short["matrix"] == [[1] * 6] * 6
    assert shorten([{"a": 1}] * 71) == [{"a": 1}]
