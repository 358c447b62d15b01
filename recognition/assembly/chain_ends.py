"""Detection of chain ends at which the string may continue."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from recognition.geometry.polyline import end_direction, unit_vectors
from recognition.messages import format_position
from recognition.model.chains import Chain, End
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
MAX_LOW_PART_RADII = 9.0
"""Maximum length of a part of a string that a single viewpoint shows as low as the table, in radii. Matching windows
lower parts of this length."""
END_PART_RADII = 5.0
"""Length of the part of a chain that a finding on its end concerns, in radii."""
WHICH: tuple[Which, Which] = ("first", "last")
"""Names of the ends of a chain, in the order of its points."""


@dataclass(frozen=True, eq=False)
class ChainEnd:
    """One end of an open chain."""

    number: int
    """Index of the chain."""
    chain: Chain
    """The chain."""
    at: int
    """0 for the first end, 1 for the last: the index into `Chain.ends`."""

    @property
    def name(self) -> Which:
        """Name of the end."""
        return WHICH[self.at]

    @property
    def line(self) -> NDArray[np.float64]:
        """(N, 3) points of the chain from this end on, metres, base frame."""
        return self.chain.points[::-1] if self.at else self.chain.points

    @property
    def point(self) -> NDArray[np.float64]:
        """(3,) position of the end, metres, base frame."""
        return self.line[0]

    def part_m(self, length_m: float) -> tuple[float, float]:
        """Return the arc lengths of the part of the chain within `length_m` of this end, metres."""
        if self.at:
            return max(self.chain.length_m - length_m, 0.0), self.chain.length_m
        return 0.0, min(length_m, self.chain.length_m)


def open_ends(chains: Sequence[Chain]) -> list[ChainEnd]:
    """Return the two ends of each open chain."""
    ends = []
    for number, chain in enumerate(chains):
        if not chain.closed:
            ends += [ChainEnd(number, chain, 0), ChainEnd(number, chain, 1)]
    return ends


def with_ends(chains: Sequence[Chain], kinds: Sequence[Sequence[End]]) -> tuple[Chain, ...]:
    """Return the chains with the given kinds of their first and last ends. Unchanged chains are kept."""
    marked = []
    for chain, (first, last) in zip(chains, kinds, strict=True):
        if (first, last) == chain.ends:
            marked.append(chain)
        else:
            marked.append(replace(chain, ends=(first, last)))
    return tuple(marked)


def mark_ends_at_unexplained_surface(
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
    kinds = [list(chain.ends) for chain in chains]
    for end in open_ends(chains):
        # Unexplained surface begins at twice this radius from the chain.
        r = max(end.chain.radius_m, parameters.r)
        if _continues(end.line, rest, r):
            kinds[end.number][end.at] = "unobserved"
    return with_ends(chains, kinds)


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
    ends = open_ends(chains)
    directions = [end_direction(end.line, DIRECTION_LENGTH_RADII * end.chain.radius_m) for end in ends]
    kinds = [list(chain.ends) for chain in chains]
    findings = []
    for n, end in enumerate(ends):
        for m, other in enumerate(ends[:n]):
            max_gap = MAX_FACING_GAP_RADII * max(end.chain.radius_m, other.chain.radius_m)
            gap = float(np.linalg.norm(end.point - other.point))
            is_facing = gap < max_gap and directions[n] @ directions[m] < MAX_FACING_COSINE
            if is_facing and not _is_gap_visible(end.point, other.point, end.chain.radius_m, views):
                kinds[end.number][end.at] = "touching"
                kinds[other.number][other.at] = "touching"
                message = _describe_touching(other, end)
                findings += [
                    _end_finding("ends-touching", message, facing, value=gap, limit=max_gap) for facing in (other, end)
                ]
    return with_ends(chains, kinds), findings


def _describe_touching(other: ChainEnd, end: ChainEnd) -> str:
    """Return the message on two ends that face each other."""
    pair = f"the ends of chain {end.number}"
    if other.number != end.number:
        pair = f"an end of chain {other.number} and an end of chain {end.number}"
    position = format_position(end.point)
    return f"{pair} face each other at {position}: one string may continue there; check the radius"


def _is_gap_visible(a: NDArray[np.float64], b: NDArray[np.float64], r: float, views: Sequence[NormalCloud]) -> bool:
    """Return whether half of the views look through a point of the straight line between two ends (3,)."""
    n_steps = max(int(np.linalg.norm(b - a) / (STEP_RADII * r)), 1)
    between = np.linspace(a, b, n_steps + 1)
    return bool(count_views(between, r, views).is_free.any())


def mark_ends_without_free_space(
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
    distances = np.arange(STEP_RADII, MAX_AHEAD_RADII + STEP_RADII / 2, STEP_RADII)
    kinds = [list(chain.ends) for chain in chains]
    for end in open_ends(chains):
        if end.chain.ends[end.at] != "free":
            continue
        r = max(end.chain.radius_m, parameters.r)
        outward = unit_vectors(end_direction(end.line, DIRECTION_LENGTH_RADII * r) * (1.0, 1.0, 0.0))
        counts = count_views(end.point + r * distances[:, None] * outward, r, views)
        is_free = (counts.through >= min(MIN_VIEWS, counts.views)) & (counts.through >= counts.stopped)
        if not is_free.any():
            kinds[end.number][end.at] = "unobserved"
    return with_ends(chains, kinds)


def mark_ends_before_low_parts(
    chains: Sequence[Chain], unexplained: Sequence[NDArray[np.float64]], parameters: ChainParameters
) -> tuple[Chain, ...]:
    """Mark a `free` end as `unobserved` if its string may go on beyond a part that is measured as low as the table.

    It may if unexplained surface lies ahead of the end, or another end that does not point away, within
    `MAX_LOW_PART_RADII`. Directions are compared from above, because the heights of a single viewpoint are uneven.
    Several viewpoints average them.

    Args:
        chains: Chains of a model of a single viewpoint.
        unexplained: (M, 3) points of each piece of unexplained surface, metres, base frame.
        parameters: Method parameters; uses the radius r. A chain thicker than r uses its own radius.
    """
    ends = open_ends(chains)
    radii = np.array([max(end.chain.radius_m, parameters.r) for end in ends])
    points = np.array([end.point[:2] for end in ends]).reshape(-1, 2)
    directions = [end_direction(end.line, DIRECTION_LENGTH_RADII * r) for end, r in zip(ends, radii, strict=True)]
    outward = unit_vectors(np.array(directions).reshape(-1, 3)[:, :2])
    rest = np.vstack([np.empty((0, 3)), *unexplained])[:, :2]
    offset = points[None] - points[:, None]
    is_ahead = np.einsum("nmk,nk->nm", offset, outward) > 0
    is_near = np.linalg.norm(offset, axis=2) < MAX_LOW_PART_RADII * np.minimum(radii, radii[:, None])
    is_facing = is_ahead & is_ahead.T & is_near
    kinds = [list(chain.ends) for chain in chains]
    for n, end in enumerate(ends):
        goes_on = is_facing[n].any() or _is_ahead(rest - points[n], outward[n], MAX_LOW_PART_RADII * radii[n]).any()
        if goes_on and end.chain.ends[end.at] == "free":
            kinds[end.number][end.at] = "unobserved"
    return with_ends(chains, kinds)


def unobserved_end_findings(chains: Sequence[Chain], scene: Scene, parameters: ChainParameters) -> list[Finding]:
    """Return a finding on each `unobserved` end: a note at the border of the workspace, otherwise a doubt.

    Args:
        chains: Chains of the model.
        scene: Scene; uses the workspace.
        parameters: Method parameters; uses the border margin r_f.
    """
    findings = []
    for end in open_ends(chains):
        if end.chain.ends[end.at] != "unobserved":
            continue
        name = f"the {end.name} end of chain {end.chain.id} at {format_position(end.point)}"
        if scene.is_near_border(end.point, parameters.r_f):
            message = f"{name} is at the border of the workspace; the string may continue outside"
            findings.append(_end_finding("end-at-border", message, end))
        else:
            message = f"{name} was not observed; the string may continue there"
            findings.append(_end_finding("end-unobserved", message, end))
    return findings


def _end_finding(
    code: FindingCode, message: str, end: ChainEnd, value: float | None = None, limit: float | None = None
) -> Finding:
    """Return a finding on an end. It concerns the part of the chain within `END_PART_RADII` of the end."""
    return finding(
        code,
        message,
        chains=(end.chain.id,),
        end=end.name,
        s_range_m=end.part_m(END_PART_RADII * end.chain.radius_m),
        point=end.point,
        value=value,
        limit=limit,
    )


def _continues(line: NDArray[np.float64], rest: NDArray[np.float64], r: float) -> bool:
    """Return whether a point of `rest` (M, 3) lies near and ahead of the first point of `line` (N, 3)."""
    outward = end_direction(line, DIRECTION_LENGTH_RADII * r)
    return bool(_is_ahead(rest - line[0], outward, MAX_CONTINUATION_RADII * r).any())


def _is_ahead(offset: NDArray[np.float64], outward: NDArray[np.float64], reach_m: float) -> NDArray[np.bool_]:
    """Return which offsets (M, D) from an end lie ahead of it, within `reach_m`. `outward` (D,) is its direction."""
    distance = np.linalg.norm(offset, axis=1)
    return (offset @ outward > MIN_AHEAD_COSINE * distance) & (distance < reach_m)
