"""What FastAPI's description of the API leaves to be said better."""

from typing import Any

from fastapi import FastAPI
from fastapi.routing import APIRoute


def operation_id(route: APIRoute) -> str:
    """The name of an operation in the description: its function's."""
    return route.name


def links(*operations: str) -> dict[str, Any]:
    """The operations that can follow, by the `id` in the answer: part of the answer in the description."""
    return {"links": {name: {"operationId": name, "parameters": {"id": "$response.body#/id"}} for name in operations}}


def describe_better(app: FastAPI) -> None:
    """Has the description say of no parameter that it may be null, for one may be left out, but no address or header
    can say null; and of a stream of events what each of them is, not that the whole is text."""
    plain = app.openapi

    def described() -> dict[str, Any]:
        if app.openapi_schema is None:
            for item in plain()["paths"].values():
                for operation in item.values():
                    for parameter in operation.get("parameters", ()):
                        parameter["schema"] = _without_null(parameter["schema"])
                    for answer in operation["responses"].values():
                        for content in answer.get("content", {}).values():
                            if "itemSchema" in content:
                                content.pop("schema", None)
        return app.openapi_schema or plain()

    app.openapi = described


def _without_null(schema: dict[str, Any]) -> dict[str, Any]:
    """The schema without the choice of null that it may have."""
    choices = [choice for choice in schema.get("anyOf", ()) if choice != {"type": "null"}]
    if len(choices) != 1:
        return schema
    return choices[0] | {key: value for key, value in schema.items() if key != "anyOf"}
