"""Comparison of the models of one recording from two runs."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from cell.simulation.evaluation.curve_distance import NearestPoints, Polyline
from cell.simulation.evaluation.metrics import score
from recognition.errors import ModelError
from recognition.model.model import SCHEMA, check_schema
from service.batch.errors import BatchError

Kind = Literal["lost", "topology", "findings", "radius", "moved", "error", "gained", "same"]
"""Kinds of change, the most serious first.

`lost`: there is no model any more. `topology`: other strings, another order of crossings, or over and under exchanged.
`findings`: other doubts. `radius`: another radius. `moved`: lines moved. `error`: another error. `gained`:
there was no model before. `same`: nothing changed.
"""
KINDS: tuple[Kind, ...] = ("lost", "topology", "findings", "radius", "moved", "error", "gained", "same")


@dataclass(frozen=True)
class Change:
    """The change of one recording."""

    recording: str
    kind: Kind
    what: str = ""
    """Description, empty if nothing changed."""
    mean_m: float | None = None
    """Mean distance of the new lines from the old ones, metres. None: there are no lines to compare."""
    max_deviation_m: float | None = None
    """Largest distance between old and new lines, in both directions, metres."""


def compare_models(recording: str, before: Mapping[str, Any], after: Mapping[str, Any], tolerance_m: float) -> Change:
    """Compare two documents, each a model or an error.

    Args:
        recording: Name of the recording.
        before: Document of the first run.
        after: Document of the second run.
        tolerance_m: Limit below which moved lines and different radii count as the same, metres.

    Raises:
        BatchError: A document has another schema.
    """
    try:
        check_schema(before)
        check_schema(after)
        if "error" in before or "error" in after:
            return _compare_errors(recording, before.get("error"), after.get("error"))
        if before["chains"] == after["chains"] and before["crossings"] == after["crossings"]:
            mean, worst = (0.0, 0.0) if before["chains"] else (None, None)
            topology = ""
        else:
            mean, worst = _line_distances(before, after)
            topology = _compare_topology(before, after)
        findings = _compare_findings(before["quality"]["findings"], after["quality"]["findings"])
        radius = _compare_radii(before["chains"], after["chains"], tolerance_m)
    except ModelError as error:
        raise BatchError(f"{recording}: {error}") from error
    except (KeyError, TypeError, ValueError, AttributeError) as error:  # ScoringError is a ValueError
        raise BatchError(f"{recording}: one of the documents is not of schema {SCHEMA}: {error!r}") from error
    moved = "" if worst is None or worst <= tolerance_m else f"{_mm(worst)} at most, {_mm(mean)} on average"
    found: dict[Kind, str] = {"topology": topology, "findings": findings, "radius": radius, "moved": moved}
    kinds: list[Kind] = [kind for kind, what in found.items() if what]
    return Change(
        recording, kinds[0] if kinds else "same", "; ".join(what for what in found.values() if what), mean, worst
    )


def _compare_errors(recording: str, before: Mapping[str, Any] | None, after: Mapping[str, Any] | None) -> Change:
    if before is None:
        assert after is not None
        return Change(recording, "lost", str(after["detail"]))
    if after is None:
        return Change(recording, "gained", f"before: {before['detail']}")
    if before["type"] != after["type"]:
        return Change(recording, "error", f"{after['detail']}; before: {before['detail']}")
    return Change(recording, "same")


def _line_distances(before: Mapping[str, Any], after: Mapping[str, Any]) -> tuple[float, float] | tuple[None, None]:
    """Return the mean and the largest distance of the lines, metres."""
    old, new = (
        [
            Polyline.of(np.array(chain["points"]), chain["closed"])
            for chain in model["chains"]
            if len(chain["points"]) > 1
        ]
        for model in (before, after)
    )
    if not (old and new):
        return None, None
    to_old, to_new = (
        NearestPoints(lines).distance(np.vstack([line.densely_sampled() for line in others]))
        for lines, others in ((old, new), (new, old))
    )
    return float(to_old.mean()), float(max(to_old.max(), to_new.max()))


def _compare_topology(before: Mapping[str, Any], after: Mapping[str, Any]) -> str:
    """Return how the strings, their order, or over and under differ; empty if they do not."""
    scored = score(after, _as_truth(before))
    if scored.topology:
        return ""
    counts = [
        f"{len(before[name])} {name} became {len(after[name])}"
        for name in ("chains", "crossings")
        if len(before[name]) != len(after[name])
    ]
    if scored.confident_mistakes:
        counts.append(f"over and under exchanged at {scored.confident_mistakes}")
    return ", ".join(counts) or "another path along the strings, or over and under exchanged where they are uncertain"


def _as_truth(model: Mapping[str, Any]) -> dict[str, Any]:
    """Return a model in the form of a ground truth, so that another model can be scored against it."""
    chains = [chain for chain in model["chains"] if len(chain["points"]) > 1]
    number = {chain["id"]: k for k, chain in enumerate(chains)}
    return {
        "name": "before",
        "radius": model["parameters"]["r_m"],
        "radii": [chain["radius_m"] for chain in chains],
        "closed": [chain["closed"] for chain in chains],
        "curves": [chain["points"] for chain in chains],
        "crossings": [
            {
                "point": crossing["point"],
                "over": (number[crossing["over"]["chain"]], crossing["over"]["s_m"]),
                "under": (number[crossing["under"]["chain"]], crossing["under"]["s_m"]),
            }
            for crossing in model["crossings"]
        ],
    }


def _compare_findings(before: Sequence[Mapping[str, Any]], after: Sequence[Mapping[str, Any]]) -> str:
    """Return how the codes of the doubts and blocking findings differ. Notes do not count."""
    old, new = (
        Counter(str(found["code"]) for found in findings if found["severity"] != "note") for findings in (before, after)
    )
    changes = [f"{old[code]} {code} became {new[code]}" for code in sorted(old | new) if old[code] != new[code]]
    return ", ".join(changes)


def _compare_radii(before: Sequence[Mapping[str, Any]], after: Sequence[Mapping[str, Any]], tolerance_m: float) -> str:
    """Return how the radii differ, smallest first; empty if the number of strings differs, which is topology."""
    old, new = (sorted(chain["radius_m"] for chain in chains) for chains in (before, after))
    pairs = [(a, b) for a, b in zip(old, new, strict=False) if abs(a - b) > tolerance_m]
    if len(old) != len(new) or not pairs:
        return ""
    return "radius " + ", ".join(f"{_mm(a)} became {_mm(b)}" for a, b in pairs)


def _mm(distance_m: float | None) -> str:
    assert distance_m is not None
    return f"{distance_m * 1e3:.3g} mm"
