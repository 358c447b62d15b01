"""Every row of the manual's table of faults is named by a test that CI runs, and no other row is."""

import ast
import re
from collections.abc import Iterable
from pathlib import Path

TESTS = Path(__file__).resolve().parents[2]


def rows() -> set[int]:
    """Return the numbers of the table's rows; some lines have several."""
    page = (TESTS.parent / "docs/integrator/robustness.md").read_text()
    return {int(row) for line in re.findall(r"^\| ([\d, ]+) \|", page, re.MULTILINE) for row in line.split(",")}


def in_ci(said: Iterable[ast.AST]) -> bool:
    """Not what is only for those who ask for it."""
    return not any(isinstance(one, ast.Attribute) and one.attr in ("soak", "fuzz", "hardware") for one in said)


def fault_rows(said: ast.AST) -> set[int]:
    """The rows in what is said of a test, as `pytest.mark.fault(4)`; also of its parameters, where CI takes them."""
    if isinstance(said, ast.Call) and isinstance(said.func, ast.Attribute):
        if said.func.attr == "fault":
            return {row.value for row in said.args if isinstance(row, ast.Constant)}  # type: ignore[misc]
        if said.func.attr == "param" and not in_ci(ast.walk(said)):
            return set()
    return {row for part in ast.iter_child_nodes(said) for row in fault_rows(part)}


def of_module(tree: ast.Module) -> list[ast.expr]:
    """What a module says of all its tests."""
    for node in tree.body:
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "pytestmark":
            return node.value.elts if isinstance(node.value, ast.List) else [node.value]
    return []


def shown_in_ci() -> dict[int, list[str]]:
    """The tests that name each row, as pytest names them."""
    found: dict[int, list[str]] = {}
    for path in sorted(TESTS.rglob("test_*.py")):
        tree = ast.parse(path.read_text())
        for test in tree.body:
            if isinstance(test, ast.FunctionDef) and test.name.startswith("test_"):
                said = [*of_module(tree), *test.decorator_list]
                for row in {row for one in said for row in fault_rows(one)} if in_ci(said) else ():
                    found.setdefault(row, []).append(f"{path.relative_to(TESTS.parent)}::{test.name}")
    return found


def test_every_fault_is_shown() -> None:
    told, shown = rows(), shown_in_ci()
    assert told == set(range(1, max(told) + 1)), "a row of the table is missing"
    for row, tests in sorted(shown.items()):
        print(f"{row:2}", *tests, sep="  ")
    missing = told - shown.keys()
    assert not missing, f"no test in CI shows the faults {missing}: mark those that do with pytest.mark.fault(row)"
    strange = {row: tests for row, tests in shown.items() if row not in told}
    assert not strange, f"the table in docs/integrator/robustness.md has no such rows: {strange}"


def test_what_only_those_who_ask_for_it_see_does_not_count() -> None:
    parameter = (
        "parametrize('a', [pytest.param(1, marks=[mark.fault(3), mark.soak]), pytest.param(2, marks=mark.fault(4))])"
    )
    assert fault_rows(ast.parse(parameter)) == {4}
    assert not in_ci([ast.parse("pytest.mark.soak", mode="eval").body])
