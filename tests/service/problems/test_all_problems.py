"""Each problem type with a status has a test that runs in CI and provokes it, and the marks name no other types."""

import ast
from collections.abc import Iterator

from service.problems.problem_types import PROBLEM_TYPES
from tests.service.faults.test_all_rows import TESTS, module_marks, runs_in_ci
from tests.service.problems import test_calibration_problems, test_scan_problems

NOT_PROVOKED = {
    "bad-frame": "the view is missing, with this reason; the scan then has too few views",
    "calibration-mismatch": "an activation by HTTP does not compare the devices; a later scan is refused: calibration",
    "calibration-stale": "an activation takes a result of any age; a later scan is refused: calibration",
    "cell": "only faults of simulated devices cause it, and no call over HTTP has them",
    "upload-incomplete": "its sender has gone; tests/service/problems/test_request_problems.py reads the audit log",
}
"""Types with a status that no answer and no scan or calibration has in a test, with the reason."""
PARAMETERS = {
    "test_a_failure_of_recognition_is_the_problem_of_the_scan": test_scan_problems.INJECTED,
    "test_a_failure_of_the_solver_is_the_problem_of_the_run": test_calibration_problems.INJECTED,
    "test_a_result_that_cannot_be_used_is_not_activated": test_calibration_problems.NOT_ACTIVATED.values(),
}
"""Problem types of tests whose parameters are marked."""


def marked_problems(mark: ast.AST) -> Iterator[str]:
    """Yield the slugs in a mark such as `pytest.mark.problem("busy")`."""
    for node in ast.walk(mark):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr == "problem":
            yield from (str(argument.value) for argument in node.args if isinstance(argument, ast.Constant))


def provoked() -> dict[str, list[str]]:
    """Return the node ids of the tests of each problem type."""
    found: dict[str, list[str]] = {}
    for path in sorted((TESTS / "service").rglob("test_*.py")):
        tree = ast.parse(path.read_text())
        for test in tree.body:
            if isinstance(test, ast.FunctionDef) and test.name.startswith("test_"):
                marks = [*module_marks(tree), *test.decorator_list]
                slugs = {slug for mark in marks for slug in marked_problems(mark)} if runs_in_ci(marks) else set()
                for slug in slugs.union(PARAMETERS.get(test.name, ())):
                    found.setdefault(slug, []).append(f"{path.relative_to(TESTS.parent)}::{test.name}")
    return found


def test_every_problem_type_is_provoked() -> None:
    """A fixture in tests/service/conftest.py checks that a marked test provokes its problems."""
    found = provoked()
    for slug, tests in sorted(found.items()):
        print(slug, *tests, sep="  ")
    with_status = {slug for slug, kind in PROBLEM_TYPES.items() if kind.status is not None}
    missing = with_status - found.keys() - NOT_PROVOKED.keys()
    assert not missing, f"mark the tests of {missing} with pytest.mark.problem(slug)"
    assert found.keys() - with_status == set()
    assert found.keys() & NOT_PROVOKED.keys() == set()
    assert NOT_PROVOKED.keys() <= with_status
