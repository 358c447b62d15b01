"""Statements that a reader must unpack are rare in recognition and calibration.

People skim code, one thing a line. In `a, b = x, y` the reader matches names with values by position. A comprehension
with two loops and a conditional expression among arguments are read from the inside out. A class inside a function is
hidden from the reader of the module. The limits leave room for pairs that are one thing, such as `low, high = ...`.
"""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
COMPREHENSIONS = (ast.ListComp, ast.SetComp, ast.DictComp, ast.GeneratorExp)

LIMITS = {
    "recognition": {"parallel": 4, "comprehension": 2, "conditional": 2, "class": 0},
    "calibration": {"parallel": 4, "comprehension": 0, "conditional": 0, "class": 0},
}
"""Maximum count of each kind of statement, by package."""

SNIPPET = """
left, right = first, second
a, b = b, a
points[0], points[1] = points[1], points[0]
width, height = measure(image)
cells = [cell for row in rows for cell in row]
names = [[name for name in row] for row in rows]
draw(red if hot else blue)
draw(colour=red if hot else blue)
size = small if cold else (medium if warm else large)
colour = red if hot else blue
def build():
    class Local: ...
"""


def contains(node: ast.AST, *kinds: type[ast.AST]) -> bool:
    return any(isinstance(inner, kinds) for inner in ast.walk(node) if inner is not node)


def kinds_of(node: ast.AST) -> Iterator[str]:
    """Yield the kinds of statement of which `node` is one. A swap is not a parallel assignment."""
    match node:
        case ast.Assign(targets=targets, value=ast.Tuple(elts=values)):
            for target in targets:
                if isinstance(target, ast.Tuple) and set(map(ast.unparse, target.elts)) != set(
                    map(ast.unparse, values)
                ):
                    yield "parallel"
        case ast.ListComp() | ast.SetComp() | ast.DictComp() | ast.GeneratorExp():
            if len(node.generators) > 1 or contains(node, *COMPREHENSIONS):
                yield "comprehension"
        case ast.Call(args=arguments, keywords=keywords):
            yield from ("conditional" for argument in arguments if isinstance(argument, ast.IfExp))
            yield from ("conditional" for keyword in keywords if isinstance(keyword.value, ast.IfExp))
        case ast.IfExp():
            if contains(node, ast.IfExp):
                yield "conditional"
        case ast.FunctionDef() | ast.AsyncFunctionDef():
            if contains(node, ast.ClassDef):
                yield "class"


def find(kind: str, code: str) -> list[int]:
    """Return the line of each statement of this kind."""
    nodes = [node for node in ast.walk(ast.parse(code)) if isinstance(node, ast.stmt | ast.expr)]
    return sorted(node.lineno for node in nodes if kind in kinds_of(node))


def find_in_package(kind: str, package: str) -> list[str]:
    found = []
    for path in sorted((ROOT / package).rglob("*.py")):
        found += [f"{path.relative_to(ROOT)}:{line}" for line in find(kind, path.read_text())]
    return found


@pytest.mark.parametrize("kind", ["parallel", "comprehension", "conditional", "class"])
@pytest.mark.parametrize("package", LIMITS)
def test_statements_to_unpack_are_rare(package: str, kind: str) -> None:
    found = find_in_package(kind, package)
    assert len(found) <= LIMITS[package][kind], "\n".join(found)


@pytest.mark.parametrize(
    ("kind", "lines"), [("parallel", [2]), ("comprehension", [6, 7]), ("conditional", [8, 9, 10]), ("class", [12])]
)
def test_each_kind_is_found(kind: str, lines: list[int]) -> None:
    assert find(kind, SNIPPET) == lines
