"""Generate the page on errors from the table of problem types."""

from typing import get_args

from service.problems.problem_types import PROBLEM_TYPES, Group, ProblemType

INTRODUCTION = """\
# Errors

This page is for authors of planners and for operators. It lists every type of error, its cause, and what to do.

Each answer that is not a success is a problem document (RFC 9457) with the content type `application/problem+json`.
A scan or calibration without a result has the same document as its `problem`. The commands that print JSON, such as
`pointchain recognise`, print it as `error`.

```json
{"type": "urn:pointchain:cell-busy", "title": "The cell is busy", "status": 409,
 "detail": "scan 20260131t120000-000000-9f86d081 is under way; wait for its end or cancel it",
 "instance": "/api/scans"}
```

| member | meaning |
| --- | --- |
| `type` | `urn:pointchain:` and the name of the type, as in the headings below. Decide on this member only. |
| `title` | A short title, the same at each occurrence of a type. |
| `status` | The HTTP status. In a scan's `problem`: the status that fits the type. |
| `detail` | What happened this time and what to do, for people. Its text may change in any version. |
| `instance` | Path of the request, or of the scan. |
| `errors` | Only with `invalid-request`: a list of `where` and `what`, one for each wrong place. |

The member `problem` of `GET /api/cell` is a type too, without a document around it. The Python client has the name of
the type as `error.slug`; see [Python client](python-client.md). A later version may add types: treat an unknown one
by its status, 4xx as an error of the request or the cell, 5xx as an error of the service.

## Decide by type

| decision | types |
| --- | --- |
"""

WITHOUT_STATUS = {
    "Start a scan": "none; a value of the cell's `problem`",
    "Repeat the calibration": "none; the command line reports it",
    "Correct the command or the configuration": "none; the command line reports it",
}
"""What stands in place of a status, by group."""


def page() -> str:
    """Return the page as Markdown."""
    rows = [f"| {group} | {', '.join(map(_link, _of_group(group)))} |" for group in get_args(Group)]
    sections = [_group_section(group) for group in get_args(Group)]
    return INTRODUCTION + "\n".join(rows) + "\n\n" + "\n".join(sections)


def _of_group(group: str) -> list[str]:
    return [slug for slug, kind in PROBLEM_TYPES.items() if kind.group == group]


def _link(slug: str) -> str:
    return f"[`{slug}`](#{slug})"


def _group_section(group: str) -> str:
    types = [_type_section(slug, PROBLEM_TYPES[slug]) for slug in _of_group(group)]
    return f"## {group}\n\n" + "\n".join(types)


def _type_section(slug: str, kind: ProblemType) -> str:
    status = ", ".join(map(str, kind.statuses)) or WITHOUT_STATUS[kind.group]
    return "\n".join(
        [
            f"### {slug}",
            "",
            f"- **Title:** `{kind.title}`",
            f"- **Status:** {status}",
            *_wrapped(f"- **Cause:** {kind.cause}"),
            *_wrapped(f"- **What to do:** {kind.action}"),
            "",
        ]
    )


def _wrapped(item: str, width: int = 120) -> list[str]:
    """Break a list item into lines."""
    lines = [""]
    for word in item.split(" "):
        if lines[-1] and len(lines[-1]) + 1 + len(word) > width:
            lines.append(f"  {word}")
        else:
            lines[-1] = f"{lines[-1]} {word}" if lines[-1] else word
    return lines
