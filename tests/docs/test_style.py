"""The documents respect the limits of length and the words of docs/contributor/style.md."""

import re
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import pytest

from tests.docs.pages import DOCS, GENERATED, ROOT, name_of, prose

PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", ROOT / "service/client/README.md", *sorted(DOCS.rglob("*.md"))]
STYLE = DOCS / "contributor" / "style.md"
"""Lists the banned words, in the first column of its table."""
MAX_LINES = 250
MAX_LINES_GENERATED = 320
MAX_LINE = 120

BANNED = {
    r"anew": "again",
    r"once more": "again",
    r"who(m)?ever": "the caller, the client",
    r"he who": "the caller, the client",
    r"nought": "zero",
    r"(wound|winds?|winding) up": "drained",
    r"given up": "cancelled",
    r"the last word": "final state",
    r"(the|a|of|as|than|unless|where|not|is|are) told": "given, configured, reported",
    r"tells? of": "reports, describes",
    r"in words": "message, description",
    r"best borne": "best-supported",
    r"levell(ed|ing)": "alignment to the table plane",
    r"melt(s|ed)?": "merged",
    r"couples? of ends": "pairs of ends",
    r"strangers?": "inconsistent views",
    r"(torn|meeting|missed) ends?": "fragmented, joined, unobserved ends",
    r"(works?|worked|working) out": "computes, recognised again",
    r"so many": "N, count",
    r"mended|mends": "repaired",
    r"salvaged?": "recovered",
    r"a price on": "a penalty",
    r"behind (the|its|a) (result|stop|answer|scan|last)": "after",
}
"""Banned words, as patterns, and the replacement of each."""
_BANNED = {re.compile(rf"\b(?:{pattern})\b", re.IGNORECASE): better for pattern, better in BANNED.items()}


def prose_lines(page: Path) -> Iterator[tuple[int, str]]:
    """Yield number and text of each line of a page, without code."""
    for number, line in enumerate(prose(page).splitlines(), 1):
        in_word_table = page == STYLE and line.startswith("|")
        yield number, line.split("|", 2)[2] if in_word_table else line


def banned(line: str) -> list[str]:
    """Return a message for each banned word in a line, with its replacement."""
    found = ((pattern.search(line), better) for pattern, better in _BANNED.items())
    return [f"{match[0]!r}: write {better}" for match, better in found if match]


def long_lines(page: Path) -> list[str]:
    """Return the lines that are too long. Link targets, tables and code blocks are not counted."""
    lines = page.read_text().splitlines()
    outside = {number for number, line in enumerate(prose(page).splitlines(), 1) if line.strip()}
    shown = ((number, re.sub(r"\]\([^)]*\)", "]()", lines[number - 1])) for number in sorted(outside))
    return [
        f"{name_of(page)}:{number}: {len(line)} characters"
        for number, line in shown
        if len(line) > MAX_LINE and not line.lstrip().startswith("|")
    ]


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_a_page_is_short(page: Path) -> None:
    lines = len(page.read_text().splitlines())
    limit = MAX_LINES_GENERATED if name_of(page) in GENERATED else MAX_LINES
    assert lines <= limit, f"{name_of(page)} has {lines} lines; split it, or move facts to their own page"


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_lines_are_short(page: Path) -> None:
    wrong = long_lines(page)
    assert wrong == [], "\n".join(wrong)


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_no_banned_word_is_used(page: Path) -> None:
    wrong = [f"{name_of(page)}:{number}: {word}" for number, line in prose_lines(page) for word in banned(line)]
    assert wrong == [], "\n".join(wrong)


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_a_page_has_one_title(page: Path) -> None:
    titles = re.findall(r"^# \S.*$", prose(page), re.MULTILINE)
    assert len(titles) == 1
    assert prose(page).startswith(titles[0])


def test_the_glossary_is_alphabetical() -> None:
    lines = (DOCS / "glossary.md").read_text().splitlines()
    terms = [term for term, after in pairwise(lines) if after.startswith(": ")]
    assert len(terms) > 50
    assert terms == sorted(set(terms), key=str.lower)


@pytest.mark.parametrize(
    ("line", "count"),
    [
        ("The views are registered anew.", 1),
        ("Whoever asks is told how many.", 2),
        ("The told radius is used, as told below.", 1),
        ("The given radius is used again. The operator is informed.", 0),
        ("It works out the path and so many views.", 2),
        ("It works outside the workspace.", 0),
    ],
)
def test_banned_words_are_found(line: str, count: int) -> None:
    assert len(banned(line)) == count


def test_long_lines_are_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    page = tmp_path / "page.md"
    long = "word " * 30
    page.write_text(f"# Title\n\n{long}\n\n| {long} |\n\n```text\n{long}\n```\n\n[a link](https://{'x' * 150})\n")
    monkeypatch.setattr("tests.docs.test_style.name_of", lambda _: "page.md")
    monkeypatch.setattr("tests.docs.pages.name_of", lambda _: "page.md")
    assert long_lines(page) == [f"page.md:3: {len(long)} characters"]
