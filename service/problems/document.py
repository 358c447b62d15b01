"""Problem documents: every error over HTTP is `application/problem+json` (RFC 9457)."""

from collections.abc import Mapping
from typing import Any

from service.errors import Failure, Parameter
from service.problems.problem_types import PROBLEM_TYPES

MEDIA_TYPE = "application/problem+json"
PREFIX = "urn:pointchain:"
"""The member `type` is this and the slug."""


def status_of(slug: str) -> int:
    """Return the HTTP status of a type of problem; 500 for one that only the command line reports."""
    kind = PROBLEM_TYPES.get(slug)
    return 500 if kind is None or kind.status is None else kind.status


def error_document(slug: str, detail: str, **more: Any) -> dict[str, Any]:
    """Return an error as the command line prints it: a problem document without a status.

    Args:
        slug: Type of the problem.
        detail: What happened and what to do.
        more: Further members.
    """
    kind = PROBLEM_TYPES.get(slug)
    title = slug.replace("-", " ").capitalize() if kind is None else kind.title
    return {"type": f"{PREFIX}{slug}", "title": title, "detail": detail} | more


def problem_document(
    slug: str,
    detail: str,
    instance: str | None = None,
    parameters: Mapping[str, Parameter] | None = None,
    **more: Any,
) -> dict[str, Any]:
    """Return a problem document.

    Args:
        slug: Type of the problem.
        detail: What happened and what to do.
        instance: Path of the request or of the job that has the problem.
        parameters: Values in the detail, by name.
        more: Further members.
    """
    error = error_document(slug, detail)
    document = {"type": error["type"], "title": error["title"], "status": status_of(slug), "detail": detail}
    if instance is not None:
        document["instance"] = instance
    return document | {"parameters": dict(parameters or {})} | more


def failure_document(failure: Failure, instance: str) -> dict[str, Any]:
    """Return the problem document of a job that ended without a result; `instance` is its path."""
    return problem_document(failure.slug, failure.message, instance)
