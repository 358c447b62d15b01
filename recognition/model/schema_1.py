"""Conversion of documents of schema `pointchain/1`, whose messages have no codes, to `pointchain/2`."""

from collections.abc import Mapping
from typing import Any

SCHEMA_1 = "pointchain/1"
CODE = "pointchain-1"
"""Code of the findings of a converted document."""
REASON = "the model is of an earlier release (schema pointchain/1), which made fewer checks; recognise the scan again"


def convert(document: Mapping[str, Any]) -> dict[str, Any]:
    """Return a document of schema `pointchain/1` in the form of `pointchain/2`.

    All chains get a doubt that names the schema, because the checks of `pointchain/2` were not made. Each message
    becomes a further doubt, because its importance is not known. The ids and directions of the chains stay as they are.
    They are not canonical.

    Args:
        document: Document of schema `pointchain/1`, a model or an error. It is not checked, and not changed.

    Raises:
        KeyError: A member is missing.
        TypeError: A member has another type than in `pointchain/1`.
        AttributeError: A member has another type than in `pointchain/1`.
    """
    if "error" in document:
        return dict(document)
    quality = document["quality"]
    messages = [*quality["ambiguities"], *quality["warnings"]]
    chains = [chain["id"] for chain in document["chains"]]
    findings = [
        {"code": CODE, "severity": "doubt", "message": message, "chains": chains} for message in (REASON, *messages)
    ]
    topology = document["topology"]
    elements = [_renamed(element, "end", _end) for element in topology["p_data"]["elements"]]
    return {
        **document,
        "schema": "pointchain/2",
        "chains": [
            {
                **_renamed(chain, "ends", lambda ends: [_end(end) for end in ends]),
                "trust": "review",
                "trusted_m": [],
            }
            for chain in document["chains"]
        ],
        "crossings": [{**crossing, "trust": "review"} for crossing in document["crossings"]],
        "topology": {**topology, "p_data": {**topology["p_data"], "elements": elements}},
        "grasps": [{**grasp, "trusted": False} for grasp in document["grasps"]],
        "quality": {
            "verdict": "review",
            "findings": findings,
            "views": [{"code": None, **view} for view in quality["views"]],
        },
    }


def _renamed(members: Mapping[str, Any], name: str, rename: Any) -> dict[str, Any]:
    """Return the members, with `rename` applied to the member `name` if there is one."""
    return {key: rename(value) if key == name else value for key, value in members.items()}


def _end(end: Any) -> Any:
    """Return the kind of an end in `pointchain/2`."""
    return "unobserved" if end == "unseen" else end
