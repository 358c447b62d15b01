"""What changed in the model of one recording from one run to another."""

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from cell.simulation.evaluation.curve_distance import NearestPoints, Polyline
from cell.simulation.evaluation.metrics import score
from service.batch.errors import ArchiveError

Kind = Literal["lost", "topology", "doubts", "radius", "moved", "error", "gained", "same"]
"""Most serious first: no model any more; other strings, order, or over and under; other ambiguities; another radius;
lines elsewhere; another error; a model where there was none; nothing."""
KINDS: tuple[Kind, ...] = ("lost", "topology", "doubts", "radius", "moved", "error", "gained", "same")


@dataclass(frozen=True)
class Change:
    """Of one recording."""

    recording: str
    kind: Kind
    what: str = ""
    """In words."""
    mean_m: float | None = None
    """Mean distance of the lines after from those before; None without lines to measure between."""
    worst_m: float | None = None
    """The largest, measured from either."""


def change(recording: str, before: Mapping[str, Any], after: Mapping[str, Any], tolerance_m: float) -> Change:
    """Compares two documents of schema `pointchain/1`, models or errors. Lines that moved, and radii that differ, by
    less than `tolerance_m` count as the same.

    Raises:
        ArchiveError: one is no such document.
    """
    try:
        if "error" in before or "error" in after:
            return _of_errors(recording, before.get("error"), after.get("error"))
        if before["chains"] == after["chains"] and before["crossings"] == after["crossings"]:
            mean, worst = (0.0, 0.0) if before["chains"] else (None, None)
            topology = ""
        else:
            mean, worst = _moved(before, after)
            topology = _topology(before, after)
        doubts = _doubts(before["quality"]["ambiguities"], after["quality"]["ambiguities"])
        radius = _radii(before["chains"], after["chains"], tolerance_m)
    except (KeyError, TypeError, ValueError, AttributeError) as error:  # ScoringError is a ValueError
        raise ArchiveError(f"{recording}: one of the documents is not of schema pointchain/1: {error!r}") from error
    moved = "" if worst is None or worst <= tolerance_m else f"{_mm(worst)} at most, {_mm(mean)} on average"
    found: dict[Kind, str] = {"topology": topology, "doubts": doubts, "radius": radius, "moved": moved}
    kinds: list[Kind] = [kind for kind, what in found.items() if what]
    return Change(
        recording, kinds[0] if kinds else "same", "; ".join(what for what in found.values() if what), mean, worst
    )


def _of_errors(recording: str, before: Mapping[str, Any] | None, after: Mapping[str, Any] | None) -> Change:
    if before is None:
        assert after is not None
        return Change(recording, "lost", str(after["detail"]))
    if after is None:
        return Change(recording, "gained", f"before: {before['detail']}")
    if before["type"] != after["type"]:
        return Change(recording, "error", f"{after['detail']}; before: {before['detail']}")
    return Change(recording, "same")


def _moved(before: Mapping[str, Any], after: Mapping[str, Any]) -> tuple[float, float] | tuple[None, None]:
    """Mean and largest distance of the lines."""
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
    there, back = (
        NearestPoints(lines).distance(np.vstack([line.densely_sampled() for line in others]))
        for lines, others in ((old, new), (new, old))
    )
    return float(there.mean()), float(max(there.max(), back.max()))


def _topology(before: Mapping[str, Any], after: Mapping[str, Any]) -> str:
    """How the strings, their order, or over and under differ; empty if they do not."""
    judged = score(after, _as_truth(before))
    if judged.topology:
        return ""
    counts = [
        f"{len(before[name])} {name} became {len(after[name])}"
        for name in ("chains", "crossings")
        if len(before[name]) != len(after[name])
    ]
    if judged.confident_mistakes:
        counts.append(f"over and under exchanged at {judged.confident_mistakes}")
    return ", ".join(counts) or "another way along the strings, or over and under exchanged in doubt"


def _as_truth(model: Mapping[str, Any]) -> dict[str, Any]:
    """The model in the form of a truth, so that another one can be judged by it."""
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


def _doubts(before: Sequence[str], after: Sequence[str]) -> str:
    """By their words, but for the figures in them, which change by themselves."""
    if len(before) != len(after):
        return f"{len(before)} ambiguities became {len(after)}"
    old, new = (Counter(re.sub(r"[-\d.]+", "#", words) for words in several) for several in (before, after))
    return f"{(new - old).total()} of {len(after)} ambiguities are others" if old != new else ""


def _radii(before: Sequence[Mapping[str, Any]], after: Sequence[Mapping[str, Any]], tolerance_m: float) -> str:
    """Of as many strings, smallest first; that there are more or fewer is told already."""
    old, new = (sorted(chain["radius_m"] for chain in chains) for chains in (before, after))
    pairs = [(a, b) for a, b in zip(old, new, strict=False) if abs(a - b) > tolerance_m]
    if len(old) != len(new) or not pairs:
        return ""
    return "radius " + ", ".join(f"{_mm(a)} became {_mm(b)}" for a, b in pairs)


def _mm(distance_m: float | None) -> str:
    assert distance_m is not None
    return f"{distance_m * 1e3:.3g} mm"
