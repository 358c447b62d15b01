"""Problems that the service of a test has answered with, or that its scans and calibrations had.

The marker `problem(slug, ...)` names the problem types that a test provokes. After the test, each of them must have
been observed, with status, title and parameters of the table of problem types.
"""

import json
import re
from collections.abc import Collection
from typing import Any

import httpx2

from service.problems.document import PREFIX
from service.problems.problem_types import PROBLEM_TYPES

JOB = re.compile(r"^/api/(scans|calibration/runs)/[0-9a-z-]+$")
"""Path of a scan or of a calibration run."""

OBSERVED: list[dict[str, Any]] = []
"""Problem documents since the start of the present test."""


def observe_problem(document: dict[str, Any]) -> None:
    """Keep a problem document of an answer or a job."""
    OBSERVED.append(document)


def observe_answer(answer: httpx2.Response) -> None:
    """Keep the problem of an answer, or that of the scan or calibration in it."""
    content = answer.headers.get("content-type", "")
    if answer.is_error and content == "application/problem+json":
        if text := answer.read():  # an answer to HEAD has none
            observe_problem(json.loads(text))
    elif content == "application/json" and JOB.match(answer.request.url.path):
        text = answer.read()
        problem = json.loads(text).get("problem") if text else None
        if problem is not None:
            observe_problem(problem)


def check_observed(slugs: Collection[str]) -> None:
    """Check that each of these problem types was observed, as the table describes it.

    The observed problems of a type must together have all its parameters.
    """
    for slug in slugs:
        kind = PROBLEM_TYPES[slug]
        documents = [document for document in OBSERVED if document["type"] == f"{PREFIX}{slug}"]
        assert documents, f"the test is marked problem({slug!r}), but the service reported no such problem"
        parameters: set[str] = set()
        for document in documents:
            assert (document["status"], document["title"]) == (kind.status, kind.title), document
            assert document["detail"], document
            # a request that is not HTTP has no path
            assert document.get("instance", "/").startswith("/"), document
            for value in document["parameters"].values():
                assert not isinstance(value, str) or value in document["detail"], document
            parameters |= set(document["parameters"])
        assert parameters == set(kind.parameters), f"{slug} had the parameters {parameters}, not those of the table"
