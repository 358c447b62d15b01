"""Conversion of documents of schema `pointchain/1`, whose messages have no codes, to `pointchain/2`."""

from collections.abc import Callable, Mapping
from typing import Any

from pointchain_client.documents.decoding import DecodeError

SCHEMA_1 = "pointchain/1"
CODE = "pointchain-1"
"""Code of the findings of a converted document."""
REASON = "the model is of an earlier release (schema pointchain/1), which made fewer checks; recognise the scan again"


def convert(document: Mapping[str, Any]) -> dict[str, Any]:
    """Return a model of schema `pointchain/1` in the form of `pointchain/2`.

    All chains get a doubt that names the schema, because the checks of `pointchain/2` were not made. Each message
    becomes a further doubt, because its importance is not known.

    Args:
        document: The document. It is not changed. Only the members that the conversion needs are checked.

    Raises:
        DecodeError: A member that the conversion needs is missing, or it has another type than in `pointchain/1`.
    """
    try:
        return _converted(document)
    except KeyError as error:
        raise DecodeError(f"the member {error} is missing") from error
    except (TypeError, AttributeError) as error:
        raise DecodeError(str(error)) from error


def _converted(document: Mapping[str, Any]) -> dict[str, Any]:
    quality, topology = document["quality"], document["topology"]
    messages = [*_list(quality, "ambiguities"), *_list(quality, "warnings")]
    chains = _list(document, "chains")
    ids = [chain["id"] for chain in chains]
    findings = [
        {"code": CODE, "severity": "doubt", "message": message, "chains": ids} for message in (REASON, *messages)
    ]
    elements = [_renamed(element, "end", _end) for element in _list(topology["p_data"], "elements")]
    return {
        **document,
        "schema": "pointchain/2",
        "chains": [{**_renamed(chain, "ends", _ends), "trust": "review", "trusted_m": []} for chain in chains],
        "crossings": [{**crossing, "trust": "review"} for crossing in _list(document, "crossings")],
        "topology": {**topology, "p_data": {**topology["p_data"], "elements": elements}},
        "grasps": [{**grasp, "trusted": False} for grasp in _list(document, "grasps")],
        "quality": {
            "verdict": "review",
            "findings": findings,
            "views": [{"code": None, **view} for view in _list(quality, "views")],
        },
    }


def _renamed(members: Mapping[str, Any], name: str, rename: Callable[[Any], Any]) -> dict[str, Any]:
    """Return the members, with `rename` applied to the member `name` if there is one."""
    return {key: rename(value) if key == name else value for key, value in members.items()}


def _list(members: Mapping[str, Any], name: str) -> list[Any]:
    """Return the member `name`, or raise TypeError if it is not a list."""
    value = members[name]
    if not isinstance(value, list | tuple):
        raise TypeError(f"the member {name!r} must be a list")
    return list(value)


def _ends(ends: Any) -> Any:
    """Return the kinds of the two ends of a chain in `pointchain/2`."""
    return [_end(end) for end in ends] if isinstance(ends, list | tuple) else ends


def _end(end: Any) -> Any:
    """Return the kind of an end in `pointchain/2`."""
    return "unobserved" if end == "unseen" else end
