"""The table of problem types is complete, has no unused type, and is the only one with statuses."""

import ast
import importlib
from collections.abc import Collection, Iterator
from functools import cache
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
"""Slugs that no call or class below has as a constant, with their source."""
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
"""Index of the argument that is the slug, by the name of the called function."""
OVER_HTTP = {*SLUG_AT} - {"error_document", "failed", "HandEyeInputError"}
"""Calls whose problem is in an HTTP response or in a job."""
HTTP_PACKAGES = ("api", "client", "console", "metrics", "problems", "security", "server")
"""Packages of the service that may use HTTP."""


def sources() -> Iterator[Path]:
    for package in PACKAGES:
        yield from (path for path in (ROOT / package).rglob("*.py") if "node_modules" not in path.parts)


@cache
def calls() -> list[ast.Call]:
    """Return all calls of functions in the packages."""
    trees = [ast.parse(path.read_text()) for path in sources()]
    return [node for tree in trees for node in ast.walk(tree) if isinstance(node, ast.Call)]


def name_of(call: ast.Call) -> str:
    match call.func:
        case ast.Name(id=name) | ast.Attribute(attr=name):
            return name
    return ""


def constant(call: ast.Call, index: int) -> Any:
    argument = call.args[index] if index < len(call.args) else None
    return argument.value if isinstance(argument, ast.Constant) else None


def slugs_in_calls(names: Collection[str] = SLUG_AT.keys()) -> set[str]:
    """Return the slugs that are constants in calls of functions with these names."""
    found = set()
    for call in calls():
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
    """Return the error classes that have their own slug and that the code raises."""
    for path in sources():
        if "slug = " in path.read_text():
            importlib.import_module(".".join(path.relative_to(ROOT).with_suffix("").parts))
    made = {name_of(call) for call in calls()}

    def subclasses(kind: type[Exception]) -> Iterator[type[Exception]]:
        for child in kind.__subclasses__():
            yield child
            yield from subclasses(child)

    return {
        kind
        for kind in subclasses(Exception)
        if kind.__module__.partition(".")[0] in PACKAGES
        and isinstance(vars(kind).get("slug"), str)
        and (kind.__name__ in made or not kind.__subclasses__())
    }


@pytest.fixture(scope="module")
def classes() -> set[type[Exception]]:
    return error_classes()


def test_the_table_has_exactly_the_slugs_that_the_code_raises(classes: set[type[Exception]]) -> None:
    raised = slugs_in_calls() | {str(vars(kind)["slug"]) for kind in classes} | set(STATES)
    assert raised - set(PROBLEM_TYPES) == set()
    assert set(PROBLEM_TYPES) - raised == set()


def test_the_search_finds_calls_and_classes(classes: set[type[Exception]]) -> None:
    """A search that finds nothing would let every table pass."""
    assert {"host-not-allowed", "released", "parallel-axes", "recognition-crashed", "too-slow"} <= slugs_in_calls()
    assert {"method-not-allowed", "calibration-refused", "cell-busy"} <= slugs_in_calls()
    assert {"ProtectiveStopError", "ContradictingViewsError", "BoardError"} <= {kind.__name__ for kind in classes}


def test_each_problem_of_a_response_or_a_job_has_a_status(classes: set[type[Exception]]) -> None:
    slugs = slugs_in_calls(OVER_HTTP) | {
        str(vars(kind)["slug"])
        for kind in classes
        if issubclass(kind, (CellError, HandEyeError, BoardDetectionError, RecordingError, RecognitionError))
    }
    cell_values = {"not-connected", "released"}
    command_line_only = {"bag", "cloud", "frames", "recording", "recording-exists"}
    without = {slug for slug in slugs if PROBLEM_TYPES[slug].status is None}
    assert without - cell_values - command_line_only == set()


def test_titles_and_statuses_come_from_the_table() -> None:
    document = problem_document("cell-busy", "wait", "/api/scans", {"kind": "scan"}, extra=1)
    assert document == {
        "type": "urn:pointchain:cell-busy",
        "title": "The cell is busy",
        "status": 409,
        "detail": "wait",
        "instance": "/api/scans",
        "parameters": {"kind": "scan"},
        "extra": 1,
    }
    assert error_document("tokens", "unreadable") == {
        "type": "urn:pointchain:tokens",
        "title": PROBLEM_TYPES["tokens"].title,
        "detail": "unreadable",
    }


def test_each_type_has_a_cause_and_an_action() -> None:
    for slug, kind in PROBLEM_TYPES.items():
        for text in (kind.cause, kind.action):
            assert text.endswith("."), slug
            assert text.count(". ") <= 1, f"{slug}: two sentences at most"
        assert kind.status is None or 400 <= kind.status < 600, slug
    assert {kind.group for kind in PROBLEM_TYPES.values()} == set(get_args(Group))


def test_no_package_without_http_has_a_status() -> None:
    """The number of a status in another package would be a second table."""
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
