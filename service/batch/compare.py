"""`pointchain compare`: list what changed between two runs over the same recordings."""

import json
import sys
from collections import Counter, deque
from collections.abc import Callable, Hashable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from service.batch.errors import BatchError
from service.batch.formats import read_lines
from service.batch.model_diff import KINDS, Change, compare_models

EXIT_NOT_COMPARABLE = 2
"""Exit code if the files cannot be compared, the same as that of `diff`."""


def compare(before: Path, after: Path, tolerance_m: float, as_json: bool) -> int:
    """Print what changed from one output of `recognise` to another.

    Args:
        before: Output of the first run.
        after: Output of the second run.
        tolerance_m: Limit below which moved lines and different radii count as the same, metres.
        as_json: Print one JSON document.

    Returns:
        Exit code: 0 if nothing changed, 1 if something did, 2 if the files cannot be compared. The reason for 2 is
        printed to stderr.
    """
    try:
        pairs, removed, added = _pair(_read_run(before), _read_run(after))
        if not pairs:
            raise BatchError(f"{before} and {after} have no recording in common")
        changes = [compare_models(b.name, json.loads(a.text), json.loads(b.text), tolerance_m) for a, b in pairs]
    except BatchError as error:
        print(f"pointchain compare: {error}", file=sys.stderr)
        return EXIT_NOT_COMPARABLE
    except OSError as error:
        print(f"pointchain compare: {error.filename or error} cannot be read", file=sys.stderr)
        return EXIT_NOT_COMPARABLE
    changes.sort(key=lambda one: (KINDS.index(one.kind), -(one.max_deviation_m or 0.0)))
    counts = Counter(one.kind for one in changes)
    if as_json:
        document = {"counts": {kind: counts[kind] for kind in KINDS}, "only_before": removed, "only_after": added}
        print(json.dumps(document | {"changes": [asdict(one) for one in changes]}, allow_nan=False))
    else:
        _print_changes(changes, counts, removed, added)
    return 0 if counts["same"] == len(changes) and not removed and not added else 1


@dataclass(frozen=True)
class _RunLine:
    """A line of an output file, as text only, because the models of a batch need too much memory."""

    name: str
    """Name of the recording. If the line has none, the number of the line."""
    sha256: str | None
    """SHA-256 of the recording."""
    text: str


def _read_run(path: Path) -> list[_RunLine]:
    """Return the lines of an output file.

    Raises:
        BatchError: A line is not a JSON document.
        OSError: The file cannot be read.
    """
    lines = []
    for number, line in enumerate(read_lines(path), 1):
        try:
            recording = json.loads(line).get("recording") or {}
            lines.append(_RunLine(recording.get("file") or f"line {number}", recording.get("sha256"), line))
        except (ValueError, AttributeError) as error:
            raise BatchError(f"{path}, line {number}: not a JSON document of a model: {error}") from error
    return lines


def _pair(
    before: Sequence[_RunLine], after: Sequence[_RunLine]
) -> tuple[list[tuple[_RunLine, _RunLine]], list[str], list[str]]:
    """Pair the lines of the same recording.

    Two lines match by the same name and content; else by the same content; else by the same name, if one of the
    recordings could not be read.

    Returns:
        The pairs, and the names of the recordings that only the first or only the second run has.
    """
    pairs: list[tuple[_RunLine, _RunLine]] = []
    removed, added = list(before), list(after)
    rules: tuple[tuple[Callable[[_RunLine], Hashable], Callable[[_RunLine, _RunLine], bool]], ...] = (
        (lambda run: (run.name, run.sha256), lambda _a, _b: True),
        (lambda run: run.sha256, lambda a, _: a.sha256 is not None),
        (lambda run: run.name, lambda a, b: None in (a.sha256, b.sha256)),
    )
    for key, matches in rules:
        waiting: dict[Hashable, deque[_RunLine]] = {}
        for line in added:
            waiting.setdefault(key(line), deque()).append(line)
        unmatched = []
        for line in removed:
            others = waiting.get(key(line))
            if others and matches(line, others[0]):
                pairs.append((line, others.popleft()))
            else:
                unmatched.append(line)
        matched = {id(line) for _, line in pairs}
        removed, added = unmatched, [line for line in added if id(line) not in matched]
    return pairs, [line.name for line in removed], [line.name for line in added]


def _print_changes(
    changes: Sequence[Change], counts: Counter[str], removed: Sequence[str], added: Sequence[str]
) -> None:
    labels = {
        "lost": "model lost",
        "topology": "topology changed",
        "findings": "doubts changed",
        "radius": "radius changed",
        "moved": "lines moved",
        "error": "error changed",
        "gained": "model gained",
        "same": "unchanged",
    }
    for kind in KINDS:
        if counts[kind]:
            print(f"{counts[kind]:6d}  {labels[kind]}")
    for names, where in ((removed, "before"), (added, "after")):
        if names:
            print(f"{len(names):6d}  only {where}")
    width = max(map(len, labels.values()))
    for one in changes:
        if one.kind != "same":
            print(f"{labels[one.kind]:{width}s}  {one.recording}  {one.what}")
    for names, where in ((removed, "before"), (added, "after")):
        for name in names:
            print(f"{f'only {where}':{width}s}  {name}")
