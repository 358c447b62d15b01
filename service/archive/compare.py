"""`pointchain compare`: what changed between two runs over the same recordings."""

import json
import sys
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from service.archive.changes import KINDS, Change, change
from service.archive.errors import ArchiveError
from service.archive.formats import lines_of

UNKNOWN = 2
"""The exit code when the two cannot be compared, as of `diff`."""


def compare(before: Path, after: Path, tolerance_m: float, as_json: bool) -> int:
    """Says on stdout what changed from `before` to `after`, outputs of `recognise`. The exit code: 0 nothing, 1
    something, 2 it cannot be told, which is said on stderr."""
    try:
        old, new = _by_recording(before), _by_recording(after)
        both = [key for key in old if key in new]
        if not both:
            raise ArchiveError(f"{before} and {after} have no recording in common")
        changes = [change(_name(new[key], key), old[key], new[key], tolerance_m) for key in both]
    except ArchiveError as error:
        print(f"pointchain compare: {error}", file=sys.stderr)
        return UNKNOWN
    except OSError as error:
        print(f"pointchain compare: {error.filename} cannot be read: {error.strerror}", file=sys.stderr)
        return UNKNOWN
    changes.sort(key=lambda one: (KINDS.index(one.kind), -(one.worst_m or 0.0)))
    gone, added = ([_name(a[key], key) for key in a if key not in b] for a, b in ((old, new), (new, old)))
    counts = Counter(one.kind for one in changes)
    if as_json:
        document = {"counts": {kind: counts[kind] for kind in KINDS}, "only_before": gone, "only_after": added}
        print(json.dumps(document | {"changes": [asdict(one) for one in changes]}, allow_nan=False))
    else:
        _tell(changes, counts, gone, added)
    return 0 if counts["same"] == len(changes) and not gone and not added else 1


def _by_recording(path: Path) -> dict[str, dict[str, Any]]:
    """The documents of a run by the recording's content, else by its name, else by the number of the line."""
    documents = {}
    for number, line in enumerate(lines_of(path), 1):
        try:
            document = json.loads(line)
            recording = document.get("recording") or {}
        except (ValueError, AttributeError) as error:
            raise ArchiveError(f"{path}, line {number}: no JSON document of a model: {error}") from error
        documents[recording.get("sha256") or recording.get("file") or f"line {number}"] = document
    return documents


def _name(document: Mapping[str, Any], key: str) -> str:
    return document["recording"]["file"] if "recording" in document else key


def _tell(changes: Sequence[Change], counts: Counter[str], gone: Sequence[str], added: Sequence[str]) -> None:
    words = {
        "lost": "no model any more",
        "topology": "other topology",
        "doubts": "other doubts",
        "moved": "moved",
        "error": "another error",
        "gained": "a model now",
        "same": "the same",
    }
    for kind in KINDS:
        if counts[kind]:
            print(f"{counts[kind]:6d}  {words[kind]}")
    for names, where in ((gone, "before"), (added, "after")):
        if names:
            print(f"{len(names):6d}  only {where}")
    width = max(map(len, words.values()))
    for one in changes:
        if one.kind != "same":
            print(f"{words[one.kind]:{width}s}  {one.recording}  {one.what}")
    for names, where in ((gone, "before"), (added, "after")):
        for name in names:
            print(f"{f'only {where}':{width}s}  {name}")
