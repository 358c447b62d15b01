"""The table of problem types is complete, holds nothing else, and tells the statuses that the code gives."""

import ast
import importlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, get_args

import pytest

from cell.errors import CellError
from cell.recording.errors import RecordingTooLargeError
from service.problems.document import CELL_STATUS, INPUT_ERRORS, TITLES, problem_document
from service.problems.problem_types import PROBLEM_TYPES, Group

PACKAGES = ("service", "cell", "calibration", "recognition")
ROOT = Path(__file__).resolve().parents[3]
STATES = {
    "aborted": "stopped_problem in service/problems/document.py: the state is the slug",
    "interrupted": "the same",
    "not-connected": "default of CellStatus.slug in cell/control/status.py",
}
"""Slugs that no call below has as a constant, and where they come from."""
SLUG_AT = {
    "ProblemError": 1,
    "problem_document": 1,
    "respond": 2,
    "Refused": 1,
    "TaskFailedError": 1,
    "_answer": 1,
    "failed": 2,
    "HandEyeInputError": 0,
}
"""Which argument of a call is the slug; the status, where there is one, stands before it."""
WITH_STATUS = {"ProblemError", "problem_document", "respond", "Refused", "TaskFailedError", "_answer"}


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


def in_calls() -> dict[str, set[int]]:
    """Slugs that calls have as constants, each with the statuses that stand beside it."""
    found: dict[str, set[int]] = {}
    for call in CALLS:
        name = name_of(call)
        slug = constant(call, SLUG_AT[name]) if name in SLUG_AT else None
        if isinstance(slug, str):
            status = constant(call, SLUG_AT[name] - 1) if name in WITH_STATUS else None
            found.setdefault(slug, set()).update({status} if isinstance(status, int) else set())
        for keyword in call.keywords:
            value = keyword.value.value if isinstance(keyword.value, ast.Constant) else None
            if keyword.arg == "slug" and isinstance(value, str):
                found.setdefault(value, set())
    return found


def in_tuples() -> set[str]:
    """Return the slugs of `(slug, detail)` and `(status, slug, detail)`-like tuples that become problems."""
    names = ("service/jobs/calibration_activation.py", "service/problems/document.py")
    tuples = [
        node for name in names for node in ast.walk(ast.parse((ROOT / name).read_text())) if isinstance(node, ast.Tuple)
    ]
    first = [pair.elts[0] for pair in tuples if len(pair.elts) == 2]
    return {slug.value for slug in first if isinstance(slug, ast.Constant) and isinstance(slug.value, str)}


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
    raised = set(in_calls()) | in_tuples() | {str(vars(kind)["slug"]) for kind in classes} | set(STATES)
    assert raised - set(PROBLEM_TYPES) == set()
    assert set(PROBLEM_TYPES) - raised == set()


def test_the_scan_finds_what_it_is_for(classes: set[type[Exception]]) -> None:
    """A scan that finds nothing would let everything pass."""
    assert in_calls()["too-slow"] == {408}
    assert {"host-not-allowed", "released", "parallel-axes", "recognition-crashed"} <= set(in_calls())
    assert {"method-not-allowed", "calibration-refused"} <= in_tuples()
    assert {"ProtectiveStopError", "ContradictingViewsError", "BoardError"} <= {kind.__name__ for kind in classes}


def test_the_statuses_are_those_of_the_code(classes: set[type[Exception]]) -> None:
    for slug, statuses in in_calls().items():
        # A line of `pointchain recognise` is no answer over HTTP, so it may have a status that no answer has.
        assert statuses <= set(PROBLEM_TYPES[slug].statuses), slug
    for kind in classes:
        slug = str(vars(kind)["slug"])
        known = PROBLEM_TYPES[slug].statuses
        if known and issubclass(kind, CellError):
            assert CELL_STATUS.get(slug, 409) in known, slug
        if known and issubclass(kind, INPUT_ERRORS):
            assert (413 if issubclass(kind, RecordingTooLargeError) else 422) in known, slug


def test_titles_are_those_of_the_table() -> None:
    assert {slug: kind.title for slug, kind in PROBLEM_TYPES.items()} == TITLES
    assert problem_document(409, "cell-busy", "")["title"] == "The cell is busy"
    assert problem_document(404, "not-found", "")["title"] == "Not found"


def test_each_type_says_why_and_what_to_do() -> None:
    for slug, kind in PROBLEM_TYPES.items():
        for text in (kind.cause, kind.action):
            assert text.endswith("."), slug
            assert text.count(". ") <= 1, f"{slug}: two sentences at most"
        assert list(kind.statuses) == sorted(set(kind.statuses)), slug
        assert all(400 <= status < 600 for status in kind.statuses), slug
    assert {kind.group for kind in PROBLEM_TYPES.values()} == set(get_args(Group))
