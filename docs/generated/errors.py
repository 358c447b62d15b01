"""Generate the pages on errors from the table of problem types and from `service/openapi.json`."""

import json
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from service.api.problem_responses import ANY_REQUEST
from service.problems.document import PREFIX
from service.problems.problem_types import PROBLEM_TYPES, Group, ProblemType

DESCRIPTION = Path(__file__).parents[2] / "service/openapi.json"

INTRODUCTION = """\
# Errors

This page is for authors of planners and for operators. It lists every type of error. The page behind each
link states the cause and what to do.

Each answer that is not a success is a problem document (RFC 9457) with the content type `application/problem+json`.
A scan or calibration without a result has the same document as its `problem`. The commands that print JSON, such as
`pointchain recognise`, print it as `error`, without a `status`.

```json
{"type": "urn:pointchain:cell-busy", "title": "The cell is busy", "status": 409,
 "detail": "scan 20260131t120000-000000-9f86d081 is under way; wait for its end or cancel it",
 "instance": "/api/scans",
 "parameters": {"kind": "scan", "id": "20260131t120000-000000-9f86d081"}}
```

| member | meaning |
| --- | --- |
| `type` | `urn:pointchain:` and the name of the type, as in [All types](#all-types). Decide on this member only. |
| `title` | A short title, the same at each occurrence of a type. |
| `status` | The HTTP status. In a scan's `problem`: the status that fits the type. |
| `detail` | What happened this time and what to do, for people. Its text may change in any version. |
| `instance` | Path of the request, or of the scan. |
| `parameters` | The values in the detail, by name, for translations. Empty if there are none. |
| `errors` | Only with `invalid-request`: a list of `where` and `what`, one for each wrong place. |

The member `problem` of `GET /api/cell` is a type too, without a document around it. The Python client has the name of
the type as `error.slug`; see [Python client](python-client.md). A later version may add types: treat an unknown one
by its status, 4xx as an error of the request or the cell, 5xx as an error of the service.

The schema `Problem` in `/openapi.json` lists all types over HTTP. Each operation lists those that it can answer with.
*Operations* on the page of a type names them; *any* means that every operation can answer with this type.
"""

INTRODUCTION_OF_PAGE = """\
# {title}

This page is for authors of planners and for operators. It is about {subject}.
[Errors](../errors.md) explains the members of a problem document, and lists all types.
"""


@dataclass(frozen=True)
class Page:
    """A page on the types of some groups."""

    title: str
    """Title of the page."""
    subject: str
    """What its types are about."""
    groups: tuple[Group, ...]
    """Groups of types, in the order of the page."""


PAGES = {
    "requests": Page(
        "Errors of requests",
        "the request itself, access, and what does not exist",
        ("Correct the request", "Do not retry", "Get access"),
    ),
    "cell": Page(
        "Errors of the cell",
        "arm, camera, and scans that ended early",
        ("Start a scan", "Decide whether to scan again", "Call a person"),
    ),
    "calibration": Page(
        "Errors of the calibration",
        "the hand-eye calibration, its images and its files",
        ("Repeat the calibration",),
    ),
    "recognition": Page(
        "Errors of recognition",
        "views that give no reliable model",
        ("Check string and table",),
    ),
    "recordings": Page(
        "Errors of recordings",
        "recordings that cannot be read",
        ("Use another recording",),
    ),
    "service": Page(
        "Errors of the service",
        "a service that is busy, not ready or damaged",
        ("Retry later", "Report to the maintainer"),
    ),
    "command-line": Page(
        "Errors of the command line",
        "commands, their files, and the configuration",
        ("Correct the command or the configuration",),
    ),
}
"""The pages below `planner/errors/`, by file name."""

WITHOUT_STATUS = {
    "Start a scan": "none; a value of the cell's `problem`",
    "Correct the command or the configuration": "none; the command line reports it",
}
"""What stands in place of a status, by group."""

OUTSIDE = ("console-not-built", "manual-not-built", "method-not-allowed", "not-found")
"""Types of answers at addresses that are no operation."""


def pages() -> dict[str, str]:
    """Return the pages as Markdown, by their path below `docs/`."""
    written = {"planner/errors.md": _index()}
    for name, page in PAGES.items():
        written[f"planner/errors/{name}.md"] = _page(page)
    return written


def _index() -> str:
    toctree = ["```{toctree}", ":hidden:", "", *(f"errors/{name}" for name in PAGES), "```"]
    return "\n".join([INTRODUCTION, *_pages_table(), "", *_types_table(), "", *toctree, ""])


def _pages_table() -> list[str]:
    """Return the section that lists the pages and the decisions on each."""
    rows = [
        f"| [{page.title}](errors/{name}.md) | {page.subject} | {', '.join(map(_link_to_group, page.groups))} |"
        for name, page in PAGES.items()
    ]
    return ["## Decide by type", "", "| page | is about | what a program does |", "| --- | --- | --- |", *rows]


def _types_table() -> list[str]:
    """Return the section that lists all types. The console links to their rows, so each has an anchor."""
    rows = [
        f'| <a id="{slug}"></a>[`{slug}`](errors/{_page_of(kind.group)}.md#{slug}) | {kind.title} | {kind.group} |'
        for slug, kind in sorted(PROBLEM_TYPES.items())
    ]
    return ["## All types", "", "| type | title | what a program does |", "| --- | --- | --- |", *rows]


def _link_to_group(group: Group) -> str:
    return f"[{group}](errors/{_page_of(group)}.md#{group.lower().replace(' ', '-')})"


def _page_of(group: Group) -> str:
    """Return the name of the page that has a group."""
    return next(name for name, page in PAGES.items() if group in page.groups)


def _page(page: Page) -> str:
    introduction = INTRODUCTION_OF_PAGE.format(title=page.title, subject=page.subject)
    return "\n".join([introduction, *map(_group_section, page.groups)])


def _of_group(group: Group) -> list[str]:
    return [slug for slug, kind in PROBLEM_TYPES.items() if kind.group == group]


def _group_section(group: Group) -> str:
    types = [_type_section(slug, PROBLEM_TYPES[slug]) for slug in _of_group(group)]
    return f"## {group}\n\n" + "\n".join(types)


def _type_section(slug: str, kind: ProblemType) -> str:
    operations = [] if kind.status is None else _wrapped(f"- **Operations:** {_operations(slug)}")
    return "\n".join(
        [
            f"### {slug}",
            "",
            f"- **Title:** `{kind.title}`",
            f"- **Status:** {kind.status or WITHOUT_STATUS[kind.group]}",
            *operations,
            *_wrapped(f"- **Cause:** {kind.cause}"),
            *_wrapped(f"- **What to do:** {kind.action}"),
            *([_parameters(kind)] if kind.parameters else []),
            "",
        ]
    )


def _parameters(kind: ProblemType) -> str:
    return f"- **Parameters:** {', '.join(f'`{name}`' for name in kind.parameters)}"


def _operations(slug: str) -> str:
    """Return the operations that can answer with this type."""
    if slug in ANY_REQUEST:
        return "any"
    paths: dict[str, dict[str, Any]] = json.loads(DESCRIPTION.read_text())["paths"]
    declaring = [
        f"`{method.upper()} {path}`"
        for path, item in paths.items()
        for method, operation in item.items()
        if f"{PREFIX}{slug}" in _types(operation)
    ]
    if slug in OUTSIDE:
        return "none; the answer at an address outside `/openapi.json`"
    return ", ".join(declaring) or "none; the `problem` of a scan or calibration"


def _types(operation: dict[str, Any]) -> list[str]:
    """Return the problem types that an operation declares."""
    schemas = (
        content["schema"]
        for answer in operation["responses"].values()
        for content in answer.get("content", {}).values()
        if "allOf" in content.get("schema", {})
    )
    return [name for schema in schemas for name in schema["properties"]["type"]["enum"]]


def _wrapped(item: str, width: int = 120) -> list[str]:
    """Break a list item into lines, but not within code."""
    lines = [""]
    for word in re.findall(r"(?:`[^`]*`|[^` ])+", item):
        if lines[-1] and len(lines[-1]) + 1 + len(word) > width:
            lines.append(f"  {word}")
        else:
            lines[-1] = f"{lines[-1]} {word}" if lines[-1] else word
    return lines
