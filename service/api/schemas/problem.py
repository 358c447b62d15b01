"""Problem documents as JSON (RFC 9457)."""

from pydantic import ConfigDict, Field

from service.api.schemas.base import ApiModel
from service.errors import Failure
from service.problems.document import PREFIX, failure_document
from service.problems.problem_types import PROBLEM_TYPES

HTTP_PROBLEM_TYPES = [f"{PREFIX}{slug}" for slug, kind in sorted(PROBLEM_TYPES.items()) if kind.status is not None]
"""All values of `type` in responses and in the `problem` of a job."""


class Problem(ApiModel):
    """A problem document (RFC 9457). Programs decide on its `type`."""

    model_config = ConfigDict(extra="allow")

    type: str = Field(examples=["urn:pointchain:cell-busy"], json_schema_extra={"enum": [*HTTP_PROBLEM_TYPES]})
    title: str
    status: int
    detail: str
    instance: str | None = None
    parameters: dict[str, str | int | float] = Field(
        default={}, description="Values that the detail contains, by name. A translation of the detail uses them."
    )


def problem_resource(failure: Failure | None, instance: str) -> Problem | None:
    """Return the problem of a job that ended without a result; `instance` is the path of the job."""
    return None if failure is None else Problem.model_validate(failure_document(failure, instance))
