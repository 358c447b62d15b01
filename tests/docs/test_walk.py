"""The files and functions named in the documents exist."""

import ast
import re
from functools import cache
from pathlib import Path

import pytest

from tests.docs.pages import DOCS, ROOT, name_of, pages

WALK = DOCS / "contributor" / "walk-of-a-view.md"
MIN_HOPS = 50
"""The walk names at least this number of functions. With fewer matches, the pattern no longer finds them."""
_FUNCTION = re.compile(r"`((?:[\w.-]+/)*[\w-]+\.py):([A-Za-z_][\w.]*)`")
_FILE = re.compile(r"`((?:recognition|calibration|cell|service|tests|docs|docker|\.ci)/[\w./-]*)(?::[\w.]+)?`")


@cache
def names(file: Path) -> frozenset[str]:
    """Return the functions, classes, methods and constants of a module, methods as `Class.method`."""
    found = set()
    for node in ast.parse(file.read_text()).body:
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            found.add(node.name)
        if isinstance(node, ast.ClassDef):
            functions = (one for one in node.body if isinstance(one, ast.FunctionDef | ast.AsyncFunctionDef))
            found |= {f"{node.name}.{function.name}" for function in functions}
        targets = node.targets if isinstance(node, ast.Assign) else [getattr(node, "target", None)]
        found |= {target.id for target in targets if isinstance(target, ast.Name)}
    return frozenset(found)


def wrong_functions(text: str) -> list[str]:
    """Return each `file.py:name` of a text that does not exist."""
    return [
        f"{path}:{name}"
        for path, name in _FUNCTION.findall(text)
        if not (ROOT / path).is_file() or name not in names(ROOT / path)
    ]


def wrong_files(text: str) -> list[str]:
    """Return each path of a text that does not exist. `NAME` and `RESOURCE` stand for a chosen name."""
    paths = [path for path in _FILE.findall(text) if not re.search(r"NAME|RESOURCE", path)]
    return [path for path in paths if not (ROOT / path).exists()]


@pytest.mark.parametrize("page", pages(), ids=name_of)
def test_functions_exist(page: Path) -> None:
    assert wrong_functions(page.read_text()) == []


@pytest.mark.parametrize("page", sorted((DOCS / "contributor").rglob("*.md")), ids=name_of)
def test_files_exist(page: Path) -> None:
    assert wrong_files(page.read_text()) == []


def test_the_walk_names_functions() -> None:
    assert len(_FUNCTION.findall(WALK.read_text())) >= MIN_HOPS


def test_missing_functions_and_files_are_found() -> None:
    text = "`recognition/pipeline.py:recognise`, `cell/control/cell.py:Cell.stop`, `service/jobs/job.py:kind_of`"
    assert len(_FUNCTION.findall(text)) == 3
    assert wrong_functions(text) == []
    assert wrong_functions("`recognition/pipeline.py:recognize`") == ["recognition/pipeline.py:recognize"]
    assert wrong_functions("`cell/control/cell.py:Cell.halt`, `cell/no.py:x`") == [
        "cell/control/cell.py:Cell.halt",
        "cell/no.py:x",
    ]
    assert wrong_files("`cell/NAME.py`, `cell/arm/rtde_driver.py`, `cell/simulation/`, `cell/no.py`") == ["cell/no.py"]
