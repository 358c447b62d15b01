"""Generate the pages on findings from the table of finding types."""

from recognition.model.finding_types import FINDING_TYPES, FindingType, Severity

INTRODUCTION = """\
# Findings

This page is for authors of planners and for operators. It lists every finding of a model by its code. The page behind
each link states the meaning and what to do.

A model lists its findings in `quality.findings`, the most serious first. [Trust](trust.md) explains the verdicts that
follow from them. A finding has these members. Those that do not apply are absent.

| member | meaning |
| --- | --- |
| `code` | The code, as in [All codes](#all-codes). Decide on this member and on `severity` only. |
| `severity` | `blocking`: do not act on this part. `doubt`: it could be otherwise. `note`: something was set aside. |
| `message` | Description for people, with the position. Its text may change in any version. |
| `chains` | Ids of the chains that the finding concerns. Absent: no chain of the model. |
| `crossing` | Id of the crossing that the finding concerns. |
| `end` | `first` or `last`: the end of the chain that the finding concerns. |
| `s_range_m` | Part of the chain, as two arc lengths. Absent: the whole chain, or its passes of `crossing`. |
| `point_m` | Position in the base frame. |
| `view` | Index of the view. |
| `value` | The measured value. Its meaning and unit are on the page of the code. |
| `limit` | The limit that the value exceeds or does not reach, in the same unit. For a radius: the given radius. |

Many findings of one code and one cause are summed up in one finding: how many there are, the range of their values, and
where the largest is. This applies to what was set aside: pieces, unexplained surface and excluded views. The reason of
each view is in `quality.views`. Findings on chains, ends and crossings are never summed up: a planner needs each.

A later version may add codes: treat an unknown code by its severity. The service counts findings by code and severity
in the metric `pointchain_findings_total`.

## Decide by code

A program that decides alone can follow the column *decision*:

| decision | meaning |
| --- | --- |
| `scan again` | Another scan, if possible from more views, can resolve it. |
| `recognise again` | Recognition of the same recording, with another radius or by this version, can resolve it. |
| `ask a person` | Another scan would probably have the same finding. |
| `nothing` | The finding changes no verdict. |

If the decisions on the doubts of a model differ, ask a person. Do the same for a doubt with an unknown code, and if a
doubt remains after the second scan.

## All codes

| code | severity | decision | a program must not rely on |
| --- | --- | --- | --- |
"""

SCOPES = {
    "nothing": "no restriction",
    "model": "the completeness of the model",
    "chain": "the chains that it names",
    "part": "the part of the chain that it names, and the order of the chain",
    "crossing": "over and under at the crossing",
}
"""What a program must not rely on, by scope."""

DOUBTS = """\
# Doubts and blocking findings

This page is for authors of planners and for operators. It lists the findings that change the verdict: a program must
not rely on what they concern. [Findings](../findings.md) lists all codes, with the decision of a program on each.
"""

NOTES = """\
# Notes

This page is for authors of planners and for operators. It lists the findings that change no verdict. They say what was
set aside. [Findings](../findings.md) lists all codes.
"""

TOCTREE = """
```{toctree}
:hidden:

findings/doubts
findings/notes
```
"""


def pages() -> dict[str, str]:
    """Return the pages as Markdown, by their path below `docs/`."""
    blocking = ["## Blocking findings\n", *_sections("blocking", "###")]
    doubts = ["## Doubts\n", *_sections("doubt", "###")]
    return {
        "planner/findings.md": INTRODUCTION + "\n".join(_rows()) + "\n" + TOCTREE,
        "planner/findings/doubts.md": "\n".join([DOUBTS, *blocking, *doubts]),
        "planner/findings/notes.md": "\n".join([NOTES, *_sections("note", "##")]),
    }


def _rows() -> list[str]:
    """Return the rows of the table of all codes."""
    rows = []
    for code, kind in FINDING_TYPES.items():
        link = f"[`{code}`](findings/{_page_of(kind)}.md#{code})"
        rows.append(f"| {link} | {kind.severity} | {kind.decision} | {SCOPES[kind.scope]} |")
    return rows


def _page_of(kind: FindingType) -> str:
    """Return the name of the page that has this type."""
    return "notes" if kind.severity == "note" else "doubts"


def _sections(severity: Severity, level: str) -> list[str]:
    """Return the sections of the types of a severity, with headings of this level."""
    return [_type_section(code, kind, level) for code, kind in FINDING_TYPES.items() if kind.severity == severity]


def _type_section(code: str, kind: FindingType, level: str) -> str:
    lines = [f"{level} {code}", "", kind.meaning, "", f"- **Do:** {kind.action}"]
    if kind.value is not None:
        lines.append(f"- **Value:** {kind.value}")
    return "\n".join([*lines, ""])
