"""What schemathesis has to know of the service, besides its description; loaded by schemathesis, in its own process."""

import json
import os
from pathlib import Path
from typing import Any

import schemathesis
from hypothesis import strategies as st

from service.problems.document import MEDIA_TYPE
from service.problems.problem_types import PROBLEM_TYPES

RECORDING = "FUZZ_RECORDING"
"""Variable that names a recording that can be used."""

KNOWN = {slug for slug, kind in PROBLEM_TYPES.items() if kind.status is not None}
"""Slugs of all problems."""

# A hundred random bytes are never a recording.
schemathesis.openapi.media_type(
    "application/octet-stream", st.sampled_from([Path(os.environ[RECORDING]).read_bytes()]) | st.binary()
)


@schemathesis.hook
def before_load_schema(context: schemathesis.HookContext, raw_schema: Any) -> None:
    """Here are tokens: nobody is let in without."""
    for item in raw_schema["paths"].values():
        for operation in item.values():
            if "security" in operation:
                operation["security"] = [needed for needed in operation["security"] if needed]


@schemathesis.hook
def filter_failure(
    context: schemathesis.HookContext, failure: Exception, case: schemathesis.Case, response: schemathesis.Response
) -> bool:
    """Drop failures that the description allows.

    These are a refusal because of what a valid request refers to, and a declared 503 or 507.
    """
    match type(failure).__name__:
        case "RejectedPositiveData":
            # This one type alone says that the request is not as described.
            return slug(response) in (None, "invalid-request")
        case "ServerError":
            described = str(response.status_code) in case.operation.definition.raw["responses"]
            return slug(response) is None or not described
    return True


@schemathesis.check
def problem_is_known(ctx: schemathesis.CheckContext, response: schemathesis.Response, case: schemathesis.Case) -> None:
    """Every answer that is no success is a problem of a type that we know."""
    if response.status_code < 400:
        return
    problem = json.loads(response.content)
    assert response.headers["content-type"] == [MEDIA_TYPE], response.headers["content-type"]
    assert slug(response) in KNOWN, problem["type"]
    assert problem["status"] == response.status_code
    assert problem["title"]
    assert problem["detail"]


def slug(response: schemathesis.Response) -> str | None:
    """The problem's; None: it is none."""
    try:
        return json.loads(response.content)["type"].removeprefix("urn:pointchain:")
    except (ValueError, KeyError, TypeError, AttributeError):
        return None
