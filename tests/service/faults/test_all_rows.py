"""Every row of the fault table has a test that runs in CI, and tests name no other rows."""

import ast
import re
from collections.abc import Iterable
from pathlib import Path

TESTS = Path(__file__).resolve().parents[2]


def table_rows() -> set[int]:
    """Return the numbers of the table's rows. A line can have several."""
    page = (TESTS.parent / "docs/integrator/robustness.md").read_text()
    return {int(row) for line in re.findall(r"^\| ([\d, ]+) \|", page, re.MULTILINE) for row in line.split(",")}


def runs_in_ci(marks: Iterable[ast.AST]) -> bool:
    """Return whether CI runs a test with these marks: none of them is off by default."""
    return not any(isinstance(one, ast.Attribute) and one.attr in ("soak", "fuzz", "hardware") for one in marks)


def fault_rows(mark: ast.AST) -> set[int]:
    """Return the rows in a mark such as `pytest.mark.fault(4)`, and in those parameters that CI runs."""
    if isinstance(mark, ast.Call) and isinstance(mark.func, ast.Attribute):
        if mark.func.attr == "fault":
            return {row.value for row in mark.args if isinstance(row, ast.Constant)}  # type: ignore[misc]
        if mark.func.attr == "param" and not runs_in_ci(ast.walk(mark)):
            return set()
    return {row for part in ast.iter_child_nodes(mark) for row in fault_rows(part)}


def module_marks(tree: ast.Module) -> list[ast.expr]:
    """Return the marks of a module, from `pytestmark`."""
    for node in tree.body:
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "pytestmark":
            return node.value.elts if isinstance(node.value, ast.List) else [node.value]
    return []


def rows_of_tests() -> dict[int, list[str]]:
    """Return the node ids of the tests of each row."""
    found: dict[int, list[str]] = {}
    for path in sorted(TESTS.rglob("test_*.py")):
        tree = ast.parse(path.read_text())
        for test in tree.body:
            if isinstance(test, ast.FunctionDef) and test.name.startswith("test_"):
                marks = [*module_marks(tree), *test.decorator_list]
                for row in {row for one in marks for row in fault_rows(one)} if runs_in_ci(marks) else ():
                    found.setdefault(row, []).append(f"{path.relative_to(TESTS.parent)}::{test.name}")
    return found


def test_every_fault_has_a_test() -> None:
    listed, tested = table_rows(), rows_of_tests()
    assert listed == set(range(1, max(listed) + 1)), "a row of the table is missing"
    for row, tests in sorted(tested.items()):
        print(f"{row:2}", *tests, sep="  ")
    missing = listed - tested.keys()
    assert not missing, f"faults {missing} have no test in CI: mark their tests with pytest.mark.fault(row)"
    unknown = {row: tests for row, tests in tested.items() if row not in listed}
    assert not unknown, f"the table in docs/integrator/robustness.md lacks these rows: {unknown}"


def test_tests_that_are_off_by_default_do_not_count() -> None:
    parameter = (
        "parametrize('a', [pytest.param(1, marks=[mark.fault(3), mark.soak]), pytest.param(2, marks=mark.fault(4))])"
    )
    assert fault_rows(ast.parse(parameter)) == {4}
    assert not runs_in_ci([ast.parse("pytest.mark.soak", mode="eval").body])
