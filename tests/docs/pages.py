"""The project's documents, their code blocks, headings and links."""

import re
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
GENERATED = {
    "docs/planner/errors.md",
    "docs/planner/errors/calibration.md",
    "docs/planner/errors/cell.md",
    "docs/planner/errors/command-line.md",
    "docs/planner/errors/recognition.md",
    "docs/planner/errors/recordings.md",
    "docs/planner/errors/requests.md",
    "docs/planner/errors/service.md",
    "docs/planner/findings.md",
    "docs/planner/findings/doubts.md",
    "docs/planner/findings/notes.md",
    "docs/integrator/configuration.md",
    "docs/researcher/parameters.md",
    "docs/reference/command-line.md",
    "docs/reference/command-line/cell.md",
    "docs/reference/command-line/recordings.md",
    "docs/reference/command-line/service.md",
}
"""Written by docs/generate.py."""

_FENCE = re.compile(r"^( *)(`{3,})([^\n`]*)\n(.*?)^\1\2 *$", re.MULTILINE | re.DOTALL)


def pages() -> list[Path]:
    """Return the documents: README, CONTRIBUTING, CHANGELOG, the examples' and the client's README, and the manual."""
    names = ("README.md", "CONTRIBUTING.md", "CHANGELOG.md", "examples/README.md", "service/client/README.md")
    top = [ROOT / name for name in names]
    return [*top, *sorted(DOCS.rglob("*.md"))]


def name_of(page: Path) -> str:
    """Return the page's path below the project's folder."""
    return page.relative_to(ROOT).as_posix()


@dataclass(frozen=True)
class Block:
    """A fenced code block."""

    page: str
    """Path of the page below the project's folder."""
    line: int
    """Line of the fence, from 1."""
    language: str
    """The info string: `sh`, `python`, ...; empty when there is none."""
    text: str


def blocks(page: Path) -> list[Block]:
    """Return the code blocks of a page, in order."""
    text = page.read_text()
    return [
        Block(name_of(page), text.count("\n", 0, found.start()) + 1, found[3].strip(), found[4])
        for found in _FENCE.finditer(text)
    ]


def prose(page: Path) -> str:
    """Return the page without its code blocks and inline code; the line numbers stay."""
    text = _FENCE.sub(lambda found: "\n" * found[0].count("\n"), page.read_text())
    return re.sub(r"`[^`\n]*`", "``", text)


def commands(block: Block) -> list[str]:
    """Return the commands of a `sh` block: one a line, without comments. A backslash joins lines."""
    lines = re.sub(r"\\\n\s*", "", block.text).splitlines()
    return [command for line in lines if (command := re.sub(r"(^|\s+)# .*", "", line).strip())]


def anchors(page: Path) -> set[str]:
    """Return the anchors of a page's headings and explicit targets, as GitHub and the manual form them."""
    text = _FENCE.sub("", page.read_text())
    found: dict[str, int] = {}
    for heading in re.findall(r"^#{1,6} +(.*?) *#*$", text, re.MULTILINE):
        plain = re.sub(r"[`*]|\[([^\]]*)\]\([^)]*\)", r"\1", heading)
        slug = re.sub(r"[^\w\- ]", "", plain.lower()).replace(" ", "-")
        found[slug] = found.get(slug, -1) + 1
    numbered = {f"{slug}-{k}" for slug, count in found.items() for k in range(1, count + 1)}
    return set(found) | numbered | set(re.findall(r"^\(([\w-]+)\)=$", text, re.MULTILINE))


def links(page: Path) -> list[tuple[int, str]]:
    """Return the targets of a page's Markdown links and pictures, each with its line."""
    text = prose(page)
    pattern = re.compile(r"\]\(\s*<?([^)\s>]+)>?(?:\s+\"[^\"]*\")?\s*\)|^\[[^\]]+\]:\s*(\S+)", re.MULTILINE)
    return [(text.count("\n", 0, found.start()) + 1, found[1] or found[2]) for found in pattern.finditer(text)]
