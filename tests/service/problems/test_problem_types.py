"""The table of problem types is complete, holds nothing else, and is the only place with statuses."""

import ast
import importlib
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any, get_args

import pytest

from calibration.errors import BoardDetectionError, HandEyeError
from cell.errors import CellError
from cell.recording.errors import RecordingError
from recognition.errors import RecognitionError
from service.problems.document import error_document, problem_document
from service.problems.problem_types import PROBLEM_TYPES, Group

PACKAGES = ("service", "cell", "calibration", "recognition")
ROOT = Path(__file__).resolve().parents[3]
STATES = {
    "not-connected": "default of CellStatus.slug in cell/control/status.py",
}
"""Slugs that no call below has as a constant, and where they come from."""
SLUG_AT = {
    "ProblemError": 0,
    "ServiceError": 0,
    "Failure": 0,
    "TaskFailedError": 0,
    "error_document": 0,
    "problem_document": 0,
    "_respond": 1,
    "_answer_problem": 0,
    "failed": 2,
    "HandEyeInputError": 0,
}
"""Which argument of a call is the slug."""
OVER_HTTP = {*SLUG_AT} - {"error_document", "failed", "HandEyeInputError"}
"""Calls whose problem is an answer over HTTP, or the problem of a job."""
HTTP_PACKAGES = ("api", "client", "console", "metrics", "problems", "security", "server")
"""Packages of the service that may know HTTP."""


def sources() -> Iterator[Path]:
    for package in PACKAGES:
        yield from (path for path in (ROOT / package).rglob("*.py") if "node_modules" not in path.parts)


CALLS = [node for path in sources() for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.Call)]


def name_of(call: ast.Call) -> str:
    match call.func:
        case ast.Name(id=name) | ast.Attribute(attr=name):
            return name
    return ""


def constant(call: ast.Call, index: int) -> Any:
    argument = call.args[index] if index < len(call.args) else None
    return argument.value if isinstance(argument, ast.Constant) else None


def in_calls(names: Collection[str] = SLUG_AT.keys()) -> set[str]:
    """Return the slugs that calls of these names have as constants."""
    found = set()
    for call in CALLS:
        name = name_of(call)
        slug = constant(call, SLUG_AT[name]) if name in names else None
        if isinstance(slug, str):
            found.add(slug)
        for keyword in call.keywords:
            value = keyword.value.value if isinstance(keyword.value, ast.Constant) else None
            if keyword.arg == "slug" and isinstance(value, str):
                found.add(value)
    return found


def error_classes() -> set[type[Exception]]:
    """Return the classes of errors with a slug of their own that the code raises."""
    for path in sources():
        if "slug = " in path.read_text():
            importlib.import_module(".".join(path.relative_to(ROOT).with_suffix("").parts))
    made = {name_of(call) for call in CALLS}

    def below(kind: type[Exception]) -> Iterator[type[Exception]]:
        for child in kind.__subclasses__():
            yield child
            yield from below(child)

    return {
        kind
        for kind in below(Exception)
        if kind.__module__.partition(".")[0] in PACKAGES
        and isinstance(vars(kind).get("slug"), str)
        and (kind.__name__ in made or not kind.__subclasses__())
    }


@pytest.fixture(scope="module")
def classes() -> set[type[Exception]]:
    return error_classes()


def test_each_slug_that_the_code_raises_is_in_the_table_and_no_other(classes: set[type[Exception]]) -> None:
    raised = in_calls() | {str(vars(kind)["slug"]) for kind in classes} | set(STATES)
    assert raised - set(PROBLEM_TYPES) == set()
    assert set(PROBLEM_TYPES) - raised == set()


def test_the_scan_finds_what_it_is_for(classes: set[type[Exception]]) -> None:
    """A scan that finds nothing would let everything pass."""
    assert {"host-not-allowed", "released", "parallel-axes", "recognition-crashed", "too-slow"} <= in_calls()
    assert {"method-not-allowed", "calibration-refused", "cell-busy"} <= in_calls()
    assert {"ProtectiveStopError", "ContradictingViewsError", "BoardError"} <= {kind.__name__ for kind in classes}


def test_each_problem_of_an_answer_or_of_a_job_has_a_status(classes: set[type[Exception]]) -> None:
    slugs = in_calls(OVER_HTTP) | {
        str(vars(kind)["slug"])
        for kind in classes
        if issubclass(kind, (CellError, HandEyeError, BoardDetectionError, RecordingError, RecognitionError))
    }
    values_of_the_cell = {"not-connected", "released"}
    only_on_the_command_line = {"bag", "cloud", "frames", "recording", "recording-exists"}
    without = {slug for slug in slugs if PROBLEM_TYPES[slug].status is None}
    assert without - values_of_the_cell - only_on_the_command_line == set()


def test_titles_and_statuses_come_from_the_table() -> None:
    document = problem_document("cell-busy", "wait", "/api/scans", extra=1)
    assert document == {
        "type": "urn:pointchain:cell-busy",
        "title": "The cell is busy",
        "status": 409,
        "detail": "wait",
        "instance": "/api/scans",
        "extra": 1,
    }
    assert error_document("tokens", "unreadable") == {
        "type": "urn:pointchain:tokens",
        "title": PROBLEM_TYPES["tokens"].title,
        "detail": "unreadable",
    }


def test_each_type_says_why_and_what_to_do() -> None:
    for slug, kind in PROBLEM_TYPES.items():
        for text in (kind.cause, kind.action):
            assert text.endswith("."), slug
            assert text.count(". ") <= 1, f"{slug}: two sentences at most"
        assert kind.status is None or 400 <= kind.status < 600, slug
    assert {kind.group for kind in PROBLEM_TYPES.values()} == set(get_args(Group))


def test_nothing_outside_the_http_packages_has_a_status() -> None:
    """A number of a status in any other package would be a second table."""
    statuses = {kind.status for kind in PROBLEM_TYPES.values()} - {None}
    found = []
    for path in sources():
        parts = path.relative_to(ROOT).parts
        if parts[0] == "service" and parts[1] not in HTTP_PACKAGES:
            numbers = (
                node
                for node in ast.walk(ast.parse(path.read_text()))
                if isinstance(node, ast.Constant) and type(node.value) is int
            )
            found += [f"{'/'.join(parts)}:{node.lineno}: {node.value}" for node in numbers if node.value in statuses]
    assert found == []
