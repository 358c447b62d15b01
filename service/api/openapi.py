"""Corrections of the OpenAPI document that FastAPI generates."""

import json
import re
from typing import Any

from fastapi import FastAPI
from fastapi.routing import APIRoute

from service.api.examples import add_examples, read_examples


def operation_id(route: APIRoute) -> str:
    """Return the id of an operation: the name of its function."""
    return route.name


def links(*operations: str) -> dict[str, Any]:
    """Return the OpenAPI links from a response to operations that take the `id` in it."""
    return {"links": {name: {"operationId": name, "parameters": {"id": "$response.body#/id"}} for name in operations}}


def format_json(document: dict[str, Any]) -> str:
    """Return an indented document. Each list of numbers is on one line."""
    text = json.dumps(document, indent=2) + "\n"
    return re.sub(r"\[\n([^][{}\"]+)\]", lambda numbers: f"[{' '.join(numbers[1].split())}]", text)


def refine_openapi(app: FastAPI) -> None:
    """Correct the OpenAPI document of an application.

    Parameters are not nullable: a client may omit one, but no query or header can express null. An operation without
    credentials says so. A request that may be one of several schemas is a schema with a name, because without one
    code generators make no usable type of it. A constant among alternatives is a list of one value. Requests and
    answers have the recorded examples.
    """
    generate = app.openapi

    def refined() -> dict[str, Any]:
        if app.openapi_schema is None:
            examples = read_examples()
            document = generate()
            for item in document["paths"].values():
                for operation in item.values():
                    for parameter in operation.get("parameters", ()):
                        parameter["schema"] = _without_null(parameter["schema"])
                    operation.setdefault("security", [])
                    _name_request(operation, document["components"]["schemas"])
                    add_examples(operation, examples.get(operation["operationId"], {}))
            _list_constants(document)
        return app.openapi_schema or generate()

    app.openapi = refined


def _name_request(operation: dict[str, Any], schemas: dict[str, Any]) -> None:
    """Move the alternatives of a JSON request into a schema of their own, if there are several."""
    content = operation.get("requestBody", {}).get("content", {}).get("application/json", {})
    if "oneOf" in content.get("schema", {}):
        name = "".join(word.capitalize() for word in operation["operationId"].split("_")) + "Request"
        schemas[name] = content["schema"] | {"title": name}
        content["schema"] = {"$ref": f"#/components/schemas/{name}"}


def _list_constants(node: Any) -> None:
    """Write a constant among alternatives as a list of one value: some generators take it for the only alternative."""
    if isinstance(node, dict):
        for choice in node.get("anyOf", ()):
            if "const" in choice:
                choice["enum"] = [choice.pop("const")]
    for child in node.values() if isinstance(node, dict) else node if isinstance(node, list) else ():
        _list_constants(child)


def _without_null(schema: dict[str, Any]) -> dict[str, Any]:
    """Return the schema without its alternative null, if it has one."""
    choices = [choice for choice in schema.get("anyOf", ()) if choice != {"type": "null"}]
    if len(choices) != 1:
        return schema
    return choices[0] | {key: value for key, value in schema.items() if key != "anyOf"}
