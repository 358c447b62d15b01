"""Documents of schema `pointchain/1`, as an earlier release wrote them."""

import copy
from collections.abc import Sequence
from typing import Any


def as_schema_1(model: dict[str, Any], ambiguities: Sequence[str] = (), warnings: Sequence[str] = ()) -> dict[str, Any]:
    """Return a model of schema `pointchain/2` in the form of `pointchain/1`, with these messages.

    Args:
        model: Document of schema `pointchain/2`, with all grasps. It is not changed.
        ambiguities: Messages about undecided results.
        warnings: Messages about excluded data, and about data that contradict the given values.
    """
    old = copy.deepcopy(model) | {"schema": "pointchain/1"}
    for chain in old["chains"]:
        del chain["trust"], chain["trusted_m"]
        chain["ends"] = [_end(end) for end in chain["ends"]]
    for item in old["crossings"]:
        del item["trust"]
    for grasp in old["grasps"]:
        del grasp["trusted"]
    for element in old["topology"]["p_data"]["elements"]:
        if element["kind"] == "end":
            element["end"] = _end(element["end"])
    views = [{name: value for name, value in view.items() if name != "code"} for view in old["quality"]["views"]]
    old["quality"] = {"views": views, "ambiguities": list(ambiguities), "warnings": list(warnings)}
    return old


def _end(end: str) -> str:
    """Return the kind of an end in `pointchain/1`, which had no touching ends."""
    return "free" if end == "free" else "unseen"
