"""Detection of chain ends at which the string may continue."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from recognition.geometry.polyline import end_direction, unit_vectors
from recognition.messages import format_position
from recognition.model.chains import Chain
from recognition.model.finding_types import FindingCode
from recognition.model.findings import Finding, Which, finding
from recognition.parameters import ChainParameters
from recognition.preprocessing.lines_of_sight import MIN_VIEWS, count_views
from recognition.preprocessing.normals import NormalCloud
from recognition.preprocessing.target_cloud import Scene
from recognition.refinement.end_merging import MAX_FACING_COSINE
from recognition.refinement.visible_gaps import STEP_RADII

DIRECTION_LENGTH_RADII = 2.0
"""Length of chain from which the direction of an end is measured, in radii."""
MIN_AHEAD_COSINE = np.cos(np.radians(35))
"""Minimum cosine between the direction of an end and the direction from the end to a point ahead (35 degrees)."""
MAX_CONTINUATION_RADII = 3.0
"""Maximum distance from an end to its continuation, in radii. Unexplained surface begins at a distance of 2 radii."""
MAX_FACING_GAP_RADII = 1.5
"""Maximum gap between two facing ends that may belong to one string, in radii of the thicker chain.

Two whole strings that lie end to end have a larger gap because their ends are round, or they are recognised as one.
"""
MAX_AHEAD_RADII = 3.0
"""Distance ahead of an end, in radii, within which the views must see free space. Mixed pixels surround an end."""
END_PART_RADII = 5.0
"""Length of the part of a chain that a finding on its end concerns, in radii."""
WHICH: tuple[Which, Which] = ("first", "last")
"""Names of the ends of a chain, in the order of its points."""


def mark_unobserved_ends(
    chains: Sequence[Chain], unexplained: Sequence[NDArray[np.float64]], parameters: ChainParameters
) -> tuple[Chain, ...]:
    """Mark an end as `unobserved` if unexplained surface lies ahead of the end.

    The string may continue there, so its end was not observed. The continuation was perhaps too short or too poorly
    measured to be recognised.

    Args:
        chains: Chains of the model.
        unexplained: (M, 3) points of each piece of unexplained surface, metres, base frame.
        parameters: Method parameters; uses the radius r. A chain thicker than r uses its own radius.

    Returns:
        The chains with the marked ends. Closed chains are unchanged.
    """
    if not unexplained:
        return tuple(chains)
    rest = np.vstack(unexplained)
    return tuple(chain if chain.closed else _mark_ends(chain, rest, parameters) for chain in chains)


def mark_touching_ends(
    chains: Sequence[Chain], views: Sequence[NormalCloud] = ()
) -> tuple[tuple[Chain, ...], list[Finding]]:
    """Mark two ends as `touching` if they face each other within `MAX_FACING_GAP_RADII`.

    A wrong radius can split one string into two chains. In this case, pulling one chain also moves the other chain.
    The surface does not show whether the two ends belong to one string or to two strings that lie end to end. They are
    two strings if the depth images show a gap between the ends.

    Args:
        chains: Chains of the model.
        views: Registered views. Without their depth images, no gap is visible.

    Returns:
        The chains with the marked ends, and one finding on each of these ends.
    """
    ends = [(k, at) for k, chain in enumerate(chains) if not chain.closed for at in (0, 1)]
    points, directions = np.empty((len(ends), 3)), np.empty((len(ends), 3))
    for n, (k, at) in enumerate(ends):
        line = chains[k].points[:: -1 if at else 1]
        points[n], directions[n] = line[0], end_direction(line, DIRECTION_LENGTH_RADII * chains[k].radius_m)
    kinds = [list(chain.ends) for chain in chains]
    findings = []
    for n, (k, at) in enumerate(ends):
        for m, (j, other) in enumerate(ends[:n]):
            max_gap = MAX_FACING_GAP_RADII * max(chains[k].radius_m, chains[j].radius_m)
            gap = float(np.linalg.norm(points[n] - points[m]))
            is_facing = gap < max_gap and directions[n] @ directions[m] < MAX_FACING_COSINE
            if is_facing and not _is_gap_visible(points[n], points[m], chains[k].radius_m, views):
                kinds[k][at] = kinds[j][other] = "touching"
                pair = f"an end of chain {j} and an end of chain {k}" if j != k else f"the ends of chain {k}"
                position = format_position(points[n])
                message = f"{pair} face each other at {position}: one string may continue there; check the radius"
                findings += [
                    _end_finding("ends-touching", message, chains[c], end, value=gap, limit=max_gap)
                    for c, end in ((j, other), (k, at))
                ]
    return tuple(replace(chain, ends=(a, b)) for chain, (a, b) in zip(chains, kinds, strict=True)), findings


def _is_gap_visible(a: NDArray[np.float64], b: NDArray[np.float64], r: float, views: Sequence[NormalCloud]) -> bool:
    """Return whether half of the views look through a point of the straight line between two ends (3,)."""
    between = np.linspace(a, b, max(int(np.linalg.norm(b - a) / (STEP_RADII * r)), 1) + 1)
    return bool(count_views(between, r, views).is_free.any())


def mark_unseen_ends(
    chains: Sequence[Chain], views: Sequence[NormalCloud], parameters: ChainParameters
) -> tuple[Chain, ...]:
    """Mark a `free` end as `unobserved` if the views look through no point ahead of it.

    A string also seems to end where its depth is missing or too noisy. The end of a string is observed only if the
    views show free space where the string would continue: at least `MIN_VIEWS`, or all views of a scan with fewer.

    Args:
        chains: Chains of the model.
        views: Registered views. Without depth images, the chains are unchanged.
        parameters: Method parameters; uses the radius r. A chain thicker than r uses its own radius.
    """
    ends = [(k, at) for k, chain in enumerate(chains) for at in (0, 1) if chain.ends[at] == "free" and not chain.closed]
    distances = np.arange(STEP_RADII, MAX_AHEAD_RADII + STEP_RADII / 2, STEP_RADII)
    kinds = [list(chain.ends) for chain in chains]
    for k, at in ends:
        line, r = chains[k].points[:: -1 if at else 1], max(chains[k].radius_m, parameters.r)
        outward = unit_vectors(end_direction(line, DIRECTION_LENGTH_RADII * r) * (1.0, 1.0, 0.0))
        counts = count_views(line[0] + r * distances[:, None] * outward, r, views)
        is_free = (counts.through >= min(MIN_VIEWS, counts.views)) & (counts.through >= counts.stopped)
        if not is_free.any():
            kinds[k][at] = "unobserved"
    return tuple(replace(chain, ends=(a, b)) for chain, (a, b) in zip(chains, kinds, strict=True))


def unobserved_end_findings(chains: Sequence[Chain], scene: Scene, parameters: ChainParameters) -> list[Finding]:
    """Return a finding on each `unobserved` end: a note at the border of the workspace, otherwise a doubt.

    Args:
        chains: Chains of the model.
        scene: Scene; uses the workspace.
        parameters: Method parameters; uses the border margin r_f.
    """
    findings = []
    for chain in chains:
        for at in (0, 1):
            if chain.ends[at] != "unobserved":
                continue
            point = chain.points[-at]
            name = f"the {WHICH[at]} end of chain {chain.id} at {format_position(point)}"
            if scene.is_near_border(point, parameters.r_f):
                message = f"{name} is at the border of the workspace; the string may continue outside"
                findings.append(_end_finding("end-at-border", message, chain, at))
            else:
                message = f"{name} was not observed; the string may continue there"
                findings.append(_end_finding("end-unobserved", message, chain, at))
    return findings


def _end_finding(
    code: FindingCode, message: str, chain: Chain, at: int, value: float | None = None, limit: float | None = None
) -> Finding:
    """Return a finding on the first (`at` 0) or last (`at` 1) end of a chain."""
    length, part = chain.length_m, END_PART_RADII * chain.radius_m
    return finding(
        code,
        message,
        chains=(chain.id,),
        end=WHICH[at],
        s_range_m=(max(length - part, 0.0), length) if at else (0.0, min(part, length)),
        point=chain.points[-at],
        value=value,
        limit=limit,
    )


def _mark_ends(chain: Chain, rest: NDArray[np.float64], parameters: ChainParameters) -> Chain:
    """Mark each end of an open chain as `unobserved` if unexplained surface `rest` (M, 3) lies ahead of the end."""
    first, last = chain.ends
    # Unexplained surface begins at twice this radius from the chain.
    r = max(chain.radius_m, parameters.r)
    if _continues(chain.points, rest, r):
        first = "unobserved"
    if _continues(chain.points[::-1], rest, r):
        last = "unobserved"
    return replace(chain, ends=(first, last))


def _continues(line: NDArray[np.float64], rest: NDArray[np.float64], r: float) -> bool:
    """Return whether a point of `rest` (M, 3) lies near and ahead of the first point of `line` (N, 3)."""
    offset = rest - line[0]
    distance = np.linalg.norm(offset, axis=1)
    ahead = offset @ end_direction(line, DIRECTION_LENGTH_RADII * r) > MIN_AHEAD_COSINE * distance
    return bool((ahead & (distance < MAX_CONTINUATION_RADII * r)).any())
