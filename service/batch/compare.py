"""`pointchain compare`: what changed between two runs over the same recordings."""

import json
import sys
from collections import Counter, deque
from collections.abc import Callable, Hashable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from service.batch.errors import ArchiveError
from service.batch.formats import lines_of
from service.batch.model_diff import KINDS, Change, change

UNKNOWN = 2
"""The exit code when the two cannot be compared, as of `diff`."""


def compare(before: Path, after: Path, tolerance_m: float, as_json: bool) -> int:
    """Says on stdout what changed from `before` to `after`, outputs of `recognise`. The exit code: 0 nothing, 1
    something, 2 it cannot be told, which is said on stderr."""
    try:
        pairs, gone, added = _paired(_runs(before), _runs(after))
        if not pairs:
            raise ArchiveError(f"{before} and {after} have no recording in common")
        changes = [change(b.name, json.loads(a.text), json.loads(b.text), tolerance_m) for a, b in pairs]
    except ArchiveError as error:
        print(f"pointchain compare: {error}", file=sys.stderr)
        return UNKNOWN
    except OSError as error:
        print(f"pointchain compare: {error.filename or error} cannot be read", file=sys.stderr)
        return UNKNOWN
    changes.sort(key=lambda one: (KINDS.index(one.kind), -(one.worst_m or 0.0)))
    counts = Counter(one.kind for one in changes)
    if as_json:
        document = {"counts": {kind: counts[kind] for kind in KINDS}, "only_before": gone, "only_after": added}
        print(json.dumps(document | {"changes": [asdict(one) for one in changes]}, allow_nan=False))
    else:
        _tell(changes, counts, gone, added)
    return 0 if counts["same"] == len(changes) and not gone and not added else 1


@dataclass(frozen=True)
class _Run:
    """A line, of which the text alone is kept: an archive's models are many."""

    name: str
    """Of the recording; where it is not told, of the line."""
    sha256: str | None
    """Of the recording's content."""
    text: str


def _runs(path: Path) -> list[_Run]:
    """Raises ArchiveError, OSError."""
    runs = []
    for number, line in enumerate(lines_of(path), 1):
        try:
            recording = json.loads(line).get("recording") or {}
            runs.append(_Run(recording.get("file") or f"line {number}", recording.get("sha256"), line))
        except (ValueError, AttributeError) as error:
            raise ArchiveError(f"{path}, line {number}: no JSON document of a model: {error}") from error
    return runs


def _paired(before: Sequence[_Run], after: Sequence[_Run]) -> tuple[list[tuple[_Run, _Run]], list[str], list[str]]:
    """What belongs together: same name and content; else same content; else same name, where one could not be read.

    And the names of those that are in one of them only.
    """
    pairs: list[tuple[_Run, _Run]] = []
    gone, added = list(before), list(after)
    rules: tuple[tuple[Callable[[_Run], Hashable], Callable[[_Run, _Run], bool]], ...] = (
        (lambda run: (run.name, run.sha256), lambda _a, _b: True),
        (lambda run: run.sha256, lambda a, _: a.sha256 is not None),
        (lambda run: run.name, lambda a, b: None in (a.sha256, b.sha256)),
    )
    for key, fits in rules:
        waiting: dict[Hashable, deque[_Run]] = {}
        for run in added:
            waiting.setdefault(key(run), deque()).append(run)
        left = []
        for run in gone:
            others = waiting.get(key(run))
            if others and fits(run, others[0]):
                pairs.append((run, others.popleft()))
            else:
                left.append(run)
        taken = {id(run) for _, run in pairs}
        gone, added = left, [run for run in added if id(run) not in taken]
    return pairs, [run.name for run in gone], [run.name for run in added]


def _tell(changes: Sequence[Change], counts: Counter[str], gone: Sequence[str], added: Sequence[str]) -> None:
    words = {
        "lost": "no model any more",
        "topology": "other topology",
        "doubts": "other doubts",
        "radius": "another radius",
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
