"""The names in the API reference exist, are documented and load no device library."""

import ast
import importlib
import inspect
import re
import subprocess
import sys
import textwrap
from dataclasses import is_dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

REFERENCE = Path(__file__).resolve().parents[2] / "docs" / "reference"
NAMES = {
    name: kind
    for page in sorted(REFERENCE.glob("*.md"))
    for kind, name in re.findall(r"^\.\. auto(\w+):: ([\w.]+)$", page.read_text(), re.MULTILINE)
}
DEVICE_LIBRARIES = ("depthai", "rtde_control", "rtde_receive", "rtde_io", "dashboard_client", "open3d")


def resolve(name: str) -> Any:
    """Return the object with a dotted name."""
    module, _, attribute = name.rpartition(".")
    return getattr(importlib.import_module(module), attribute)


def field_docstrings(cls: Any) -> dict[str, str | None]:
    """Return the string under each annotated field of a class; None where there is none."""
    body = ast.parse(textwrap.dedent(inspect.getsource(cls))).body[0]
    assert isinstance(body, ast.ClassDef)
    docs: dict[str, str | None] = {}
    for statement, following in zip(body.body, [*body.body[1:], None], strict=True):
        if isinstance(statement, ast.AnnAssign) and isinstance(statement.target, ast.Name):
            text = following.value if isinstance(following, ast.Expr) else None
            constant = text.value if isinstance(text, ast.Constant) else None
            docs[statement.target.id] = constant if isinstance(constant, str) else None
    return docs


def test_the_pages_list_names() -> None:
    assert len(NAMES) > 50


@pytest.mark.parametrize("name", [name for name, kind in NAMES.items() if kind != "data"])
def test_each_name_has_a_docstring(name: str) -> None:
    own = resolve(name).__doc__
    assert own
    assert own.splitlines()[0].endswith(".")


@pytest.mark.parametrize("name", [name for name, kind in NAMES.items() if kind == "class"])
def test_each_field_has_a_docstring(name: str) -> None:
    cls: Any = resolve(name)
    if is_dataclass(cls):
        docs = field_docstrings(cls)
        assert [field for field, text in docs.items() if not text and not field.startswith("_")] == []


def attribute_docstrings(node: ast.AST) -> dict[str, str]:
    """Return the string under each assignment in a module, a class or its methods, by the assigned name."""
    docs = {}
    for part in ast.walk(node):
        for statement, following in pairwise(
            getattr(part, "body", []) if isinstance(part, ast.stmt | ast.Module) else []
        ):
            text = following.value if isinstance(following, ast.Expr) else None
            if isinstance(statement, ast.Assign | ast.AnnAssign) and isinstance(text, ast.Constant):
                target = statement.targets[0] if isinstance(statement, ast.Assign) else statement.target
                docs[ast.unparse(target)] = str(text.value)
    return docs


@pytest.mark.parametrize("name", NAMES)
def test_no_first_line_is_read_as_a_type(name: str) -> None:
    """Napoleon reads the text before a colon in the first line of an attribute's docstring as its type."""
    module, _, attribute = name.rpartition(".")
    if NAMES[name] == "data":
        texts = attribute_docstrings(ast.parse(inspect.getsource(importlib.import_module(module))))
        texts = {attribute: texts[attribute]}
    elif inspect.isclass(thing := resolve(name)):
        texts = attribute_docstrings(ast.parse(textwrap.dedent(inspect.getsource(thing))))
        texts |= {key: value.__doc__ or "" for key, value in vars(thing).items() if isinstance(value, property)}
    else:
        return
    outside_code = {key: re.sub(r"`[^`]*`", "", text.splitlines()[0]) for key, text in texts.items() if text}
    assert [key for key, line in outside_code.items() if ":" in line] == []


def test_importing_the_listed_modules_loads_no_device_library() -> None:
    modules = sorted({name.rpartition(".")[0] for name in NAMES})
    program = f"import sys, {', '.join(modules)}\nprint([n for n in {DEVICE_LIBRARIES} if n in sys.modules])"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True, timeout=100)
    assert done.stdout.strip() == "[]"
