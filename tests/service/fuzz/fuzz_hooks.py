"""Hooks and checks that schemathesis loads in its own process, in addition to the description of the service."""

import json
import os
from pathlib import Path
from typing import Any

import schemathesis
from hypothesis import strategies as st

from service.problems.document import MEDIA_TYPE
from service.problems.problem_types import PROBLEM_TYPES

RECORDING = "FUZZ_RECORDING"
"""Environment variable with the path of a valid recording."""

KNOWN = {slug for slug, kind in PROBLEM_TYPES.items() if kind.status is not None}
"""Slugs of all problems."""

# Random bytes are never a valid recording, so a real one is added.
schemathesis.openapi.media_type(
    "application/octet-stream", st.sampled_from([Path(os.environ[RECORDING]).read_bytes()]) | st.binary()
)


@schemathesis.hook
def before_load_schema(context: schemathesis.HookContext, raw_schema: Any) -> None:
    """Require a token where there may be one: this service has tokens. Add what generators of clients do not take."""
    for item in raw_schema["paths"].values():
        for operation in item.values():
            operation["security"] = [needed for needed in operation["security"] if needed]
            for answer in operation["responses"].values():
                for content in answer.get("content", {}).values():
                    if "x-itemSchema" in content:
                        content["itemSchema"] = content.pop("x-itemSchema")
                        del content["schema"]
    replay = raw_schema["paths"]["/api/recordings"]["post"]["responses"]["201"]["links"]["start_scan"]
    replay["requestBody"] = {"mode": "replay", "recording": "$response.body#/id"}


@schemathesis.hook
def filter_failure(
    context: schemathesis.HookContext, failure: Exception, case: schemathesis.Case, response: schemathesis.Response
) -> bool:
    """Drop failures that the description allows.

    These are a refusal because of what a valid request refers to, a declared 503 or 507, and a part that a created
    resource does not have.
    """
    match type(failure).__name__:
        case "EnsureResourceAvailability":
            # The scan was found: a replay has no plan, for example.
            return slug(response) != "no-result"
        case "RejectedPositiveData":
            # Only this problem type means that the request does not match the description.
            return slug(response) in (None, "invalid-request")
        case "ServerError":
            described = str(response.status_code) in case.operation.definition.raw["responses"]
            return slug(response) is None or not described
    return True


@schemathesis.check
def problem_is_known(ctx: schemathesis.CheckContext, response: schemathesis.Response, case: schemathesis.Case) -> None:
    """Check that every error response is a problem of a known type."""
    if response.status_code < 400:
        return
    problem = json.loads(response.content)
    assert response.headers["content-type"] == [MEDIA_TYPE], response.headers["content-type"]
    assert slug(response) in KNOWN, problem["type"]
    assert problem["status"] == response.status_code
    assert problem["title"]
    assert problem["detail"]


def slug(response: schemathesis.Response) -> str | None:
    """Return the slug of the problem; None if the response is not a problem."""
    try:
        return json.loads(response.content)["type"].removeprefix("urn:pointchain:")
    except (ValueError, KeyError, TypeError, AttributeError):
        return None
