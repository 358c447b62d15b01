"""Every row of the README's table of faults is shown by a test, in CI and in full."""

import ast
from pathlib import Path

TESTS = Path(__file__).resolve().parents[2]
ROWS = range(1, 28)


def fault_rows(said: list[ast.expr]) -> set[int]:
    """The rows in what is said of tests, as `pytest.mark.fault(4)`; also of their parameters."""
    calls = [node for one in said for node in ast.walk(one) if isinstance(node, ast.Call)]
    shown = [call for call in calls if isinstance(call.func, ast.Attribute) and call.func.attr == "fault"]
    return {row.value for call in shown for row in call.args if isinstance(row, ast.Constant)}  # type: ignore[misc]


def in_ci(said: list[ast.expr]) -> bool:
    """Not what is only for those who ask for it."""
    return not any(isinstance(one, ast.Attribute) and one.attr in ("soak", "fuzz", "hardware") for one in said)


def of_module(tree: ast.Module) -> list[ast.expr]:
    """What a module says of all its tests."""
    for node in tree.body:
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "pytestmark":
            return node.value.elts if isinstance(node.value, ast.List) else [node.value]
    return []


def shown_in_ci() -> dict[int, list[str]]:
    """The tests that show each row, as pytest names them."""
    found: dict[int, list[str]] = {row: [] for row in ROWS}
    for path in sorted(TESTS.rglob("test_*.py")):
        tree = ast.parse(path.read_text())
        for test in tree.body:
            if isinstance(test, ast.FunctionDef) and test.name.startswith("test_"):
                said = [*of_module(tree), *test.decorator_list]
                for row in fault_rows(said) if in_ci(said) else ():
                    assert row in found, f"{path}: there is no row {row}"
                    found[row].append(f"{path.relative_to(TESTS.parent)}::{test.name}")
    return found


def test_every_fault_is_shown() -> None:
    shown = shown_in_ci()
    for row, tests in shown.items():
        print(f"{row:2}", *tests, sep="  ")
    missing = [row for row, tests in shown.items() if not tests]
    assert not missing, f"no test in CI shows the faults {missing}: mark those that do with pytest.mark.fault(row)"
