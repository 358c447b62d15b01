"""String ends: how far the string really goes, and whether what is there is an end at all."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from recognition.model.model import End as EndKind
from recognition.parameters import ChainParameters
from recognition.preprocessing.target_cloud import Scene
from recognition.strand import End, Strand, strand_ends

EDGE_PERCENTILE = 95.0
"""Of the centre points ahead of an end, the share taken as string: the rest is depth noise along the axis."""


def extend_ends(strands: Sequence[Strand], single: NDArray[np.float64], parameters: ChainParameters) -> list[Strand]:
    """Open strands lengthened to where the string was measured.

    The means of eqs. (2) and (3) draw a line's ends inwards by about 2 r, and links end up to r_n before the last
    point. The unaveraged centre points c_i of eq. (1) (`single`, (N, 3)) reach the true end. Our addition to the
    paper, which leaves ends short.
    """
    return [_extended(strand, single, parameters) for strand in strands]


def _extended(strand: Strand, single: NDArray[np.float64], parameters: ChainParameters) -> Strand:
    for end in strand_ends([strand], parameters):
        ahead = _ahead(single, end.point, end.direction, parameters)
        ahead = ahead[ahead < parameters.r_cn]
        if len(ahead) == 0:
            continue
        reach = float(np.percentile(ahead, EDGE_PERCENTILE))
        steps = max(round(reach / parameters.r_n), 1)
        added = end.point + np.arange(1, steps + 1)[:, None] * (reach / steps) * end.direction
        order = slice(None, None, -1) if end.at_start else slice(None)
        parts = [strand.points, added[order]]
        marks = [strand.bridged, np.zeros(len(added), dtype=bool)]
        if end.at_start:
            parts, marks = parts[::-1], marks[::-1]
        strand = replace(strand, points=np.vstack(parts), bridged=np.concatenate(marks))
    return strand


def classify_ends(
    strand: Strand, single: NDArray[np.float64], scene: Scene, parameters: ChainParameters
) -> tuple[EndKind, EndKind]:
    """For the first and the last point: `free` when the string was seen to stop there, else `unseen`.

    It was not seen to stop when it leaves the workspace, or when something of the same height goes on ahead, as
    where it dives under another strand and comes out in a way that could not be followed. Both of a closed
    strand's are `free`: it has no end that was missed.
    """
    if strand.closed:
        return "free", "free"
    first, last = strand_ends([strand], parameters)
    return _end_kind(first, single, scene, parameters), _end_kind(last, single, scene, parameters)


def _end_kind(end: End, single: NDArray[np.float64], scene: Scene, parameters: ChainParameters) -> EndKind:
    if at_border(end.point, scene, parameters.r_f):
        return "unseen"
    ahead = _ahead(single, end.point, end.direction, parameters)
    goes_on = ((ahead > parameters.r_n) & (ahead < parameters.r_cn)).any()
    return "unseen" if goes_on else "free"


def at_border(point: NDArray[np.float64], scene: Scene, margin: float) -> bool:
    """Whether the workspace ends within `margin` of the `point` (3,), to a side or above: below is the table."""
    if scene.workspace_m is None:
        return False
    low, high = np.asarray(scene.workspace_m, dtype=np.float64).T
    return bool((point[:2] < low[:2] + margin).any() or (point > high - margin).any())


def _ahead(
    points: NDArray[np.float64],
    origin: NDArray[np.float64],
    direction: NDArray[np.float64],
    parameters: ChainParameters,
) -> NDArray[np.float64]:
    """(M,) how far ahead of `origin` those points lie that are within r of the ray along `direction`."""
    way = points - origin
    along = way @ direction
    across = np.linalg.norm(way - along[:, None] * direction, axis=1)
    return along[(along > 0) & (across < parameters.r)]
