"""Examples of requests and answers for the OpenAPI document.

They are recorded from a running service: `make api-examples` writes `examples.json`.
"""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

EXAMPLES_FILE = Path(__file__).with_name("examples.json")
"""Examples by operation id: `request`, and `responses` by status. Each example has a name, `summary` and `value`."""


def read_examples() -> dict[str, dict[str, Any]]:
    """Return the recorded examples by operation id."""
    return json.loads(EXAMPLES_FILE.read_text())


def add_examples(operation: dict[str, Any], examples: Mapping[str, Any]) -> None:
    """Add the examples of an operation to its media types. Examples for a status that it does not have are dropped.

    Args:
        operation: The operation in the OpenAPI document.
        examples: Its examples, as in `EXAMPLES_FILE`.
    """
    _add(operation.get("requestBody", {}), examples.get("request"))
    for status, response in operation["responses"].items():
        _add(response, examples.get("responses", {}).get(status))


def _add(request_or_response: dict[str, Any], examples: dict[str, Any] | None) -> None:
    for content in request_or_response.get("content", {}).values() if examples else ():
        content["examples"] = examples
