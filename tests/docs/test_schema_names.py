"""The documents, the examples and the description of the API name only schemas that the code defines."""

import re
from pathlib import Path

import pytest

from recognition.model.finding_types import FINDING_TYPES
from tests.docs.pages import ROOT, name_of, pages

TEXTS = [
    *pages(),
    ROOT / "service/openapi.json",
    ROOT / "service/api/examples.json",
    *sorted((ROOT / "examples").glob("*.py")),
    *sorted((ROOT / "examples").glob("*.ts")),
]
SOURCES = [file for folder in ("recognition", "cell", "service") for file in (ROOT / folder).rglob("*.py")]
CONSTANT = re.compile(r'^SCHEMA\w* = "([^"]+)"$', re.MULTILINE)
"""Definition of a schema name in a module."""
NAME = re.compile(r"\bpointchain[-/]\d+\b(?!\.\d)")
"""Schema name, or the code of a finding that is named after one. A file such as `pointchain-0.1.0.whl` is neither."""
DEFINED = {name for file in SOURCES for name in CONSTANT.findall(file.read_text())} | set(FINDING_TYPES)


def unknown(text: str) -> set[str]:
    """Return the schema names in a text that the code does not define."""
    return set(NAME.findall(text)) - DEFINED


@pytest.mark.parametrize("file", TEXTS, ids=name_of)
def test_only_schemas_of_the_code_are_named(file: Path) -> None:
    assert unknown(file.read_text()) == set()


def test_unknown_names_are_found() -> None:
    text = "pointchain/2 and `pointchain/0`, pointchain-0, dist/pointchain-0.1.0-py3-none-any.whl"
    assert unknown(text) == {"pointchain/0", "pointchain-0"}
