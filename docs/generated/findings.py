"""Generate the page on findings from the table of finding types."""

from recognition.model.finding_types import FINDING_TYPES, FindingType

INTRODUCTION = """\
# Findings

This page is for authors of planners and for operators. It lists every finding of a model by its code, with its meaning
and what to do.

A model lists its findings in `quality.findings`, the most serious first. [Trust](trust.md) explains the verdicts that
follow from them. A finding has these members. Those that do not apply are absent.

| member | meaning |
| --- | --- |
| `code` | The code, as in the headings below. Decide on this member and on `severity` only. |
| `severity` | `blocking`: do not act on this part. `doubt`: it could be otherwise. `note`: something was set aside. |
| `message` | Description for people, with the position. Its text may change in any version. |
| `chains` | Ids of the chains that the finding concerns. Absent: no chain of the model. |
| `crossing` | Id of the crossing that the finding concerns. |
| `end` | `first` or `last`: the end of the chain that the finding concerns. |
| `s_range_m` | Part of the chain, as two arc lengths. Absent: the whole chain, or its passes of `crossing`. |
| `point_m` | Position in the base frame. |
| `view` | Index of the view. |
| `value` | The measured value. Its meaning and unit are below. |
| `limit` | The limit that the value exceeds or does not reach, in the same unit. For a radius: the given radius. |

Many findings of one code and one cause are summed up in one finding: how many there are, the range of their values, and
where the largest is. This applies to what was set aside: pieces, unexplained surface and excluded views. The reason of
each view is in `quality.views`. Findings on chains, ends and crossings are never summed up: a planner needs each.

A later version may add codes: treat an unknown code by its severity. The service counts findings by code and severity
in the metric `pointchain_findings_total`.

## Overview

A program that decides alone can follow the column *decision*:

| decision | meaning |
| --- | --- |
| `scan again` | Another scan, if possible from more views, can resolve it. |
| `recognise again` | Recognition of the same recording, with another radius or by this version, can resolve it. |
| `ask a person` | Another scan would probably have the same finding. |
| `nothing` | The finding changes no verdict. |

If the decisions on the doubts of a model differ, ask a person. Do the same for a doubt with an unknown code, and if a
doubt remains after the second scan.

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
TITLES = {"blocking": "Blocking findings", "doubt": "Doubts", "note": "Notes"}
"""Heading of each severity."""


def page() -> str:
    """Return the page as Markdown."""
    rows = [
        f"| [`{code}`](#{code}) | {kind.severity} | {kind.decision} | {SCOPES[kind.scope]} |"
        for code, kind in FINDING_TYPES.items()
    ]
    sections = [_severity_section(severity, title) for severity, title in TITLES.items()]
    return INTRODUCTION + "\n".join(rows) + "\n\n" + "\n".join(sections)


def _severity_section(severity: str, title: str) -> str:
    kinds = [_type_section(code, kind) for code, kind in FINDING_TYPES.items() if kind.severity == severity]
    return f"## {title}\n\n" + "\n".join(kinds)


def _type_section(code: str, kind: FindingType) -> str:
    lines = [f"### {code}", "", kind.meaning, "", f"- **Do:** {kind.action}"]
    if kind.value is not None:
        lines.append(f"- **Value:** {kind.value}")
    return "\n".join([*lines, ""])
