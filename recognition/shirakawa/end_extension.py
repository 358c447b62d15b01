"""Ends of strands: extension to the end of the string, and classification as observed or unobserved."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from recognition.model.chains import End as EndKind
from recognition.parameters import ChainParameters
from recognition.preprocessing.target_cloud import Scene
from recognition.strand import End, Strand, strand_ends

REACH_PERCENTILE = 95.0
"""An end is extended to this percentile of the distances of the centre points ahead. Farther points are depth noise."""


def extend_ends(
    strands: Sequence[Strand], unaveraged: NDArray[np.float64], parameters: ChainParameters
) -> list[Strand]:
    """Extend both ends of each open strand to the measured end of the string.

    The means of eqs. (2) and (3) shorten a line by about 2 r at each end. The last link may stop up to r_n before the
    last point. The unaveraged centre points reach the end of the string.

    Args:
        strands: Strands of the scene.
        unaveraged: (N, 3) centre points c_i of eq. (1), metres.
        parameters: Method parameters; uses r, r_n, r_f and r_cn.

    Returns:
        The strands, with points added at their ends. The spacing of the added points is about r_n. Closed strands are
        unchanged.

    Source:
        Not in the paper, whose strands stop before the ends of the string.
    """
    return [_extend(strand, unaveraged, parameters) for strand in strands]


def classify_ends(
    strand: Strand, unaveraged: NDArray[np.float64], scene: Scene, parameters: ChainParameters
) -> tuple[EndKind, EndKind]:
    """Classify the ends of a strand: `free` if the end of the string was observed, else `unobserved`.

    An end is `unobserved` if it lies near the border of the workspace, or if centre points continue ahead of the end.
    Centre points continue, for example, if the string disappears under another strand and cannot be followed.

    Args:
        strand: The strand.
        unaveraged: (N, 3) centre points c_i of eq. (1), metres.
        scene: Scene; uses the workspace.
        parameters: Method parameters; uses r, r_n, r_cn, and r_f as border margin.

    Returns:
        The kinds of the first and the last end. A closed strand has two `free` ends.
    """
    if strand.closed:
        return "free", "free"
    first, last = strand_ends([strand], parameters)
    return _classify_end(first, unaveraged, scene, parameters), _classify_end(last, unaveraged, scene, parameters)


def _extend(strand: Strand, unaveraged: NDArray[np.float64], parameters: ChainParameters) -> Strand:
    for end in strand_ends([strand], parameters):
        ahead = _distances_ahead(unaveraged, end.point, end.direction, parameters)
        ahead = ahead[ahead < parameters.r_cn]
        if len(ahead) == 0:
            continue
        reach = float(np.percentile(ahead, REACH_PERCENTILE))
        n_added = max(round(reach / parameters.r_n), 1)
        added = end.point + np.arange(1, n_added + 1)[:, None] * (reach / n_added) * end.direction
        is_bridged = np.zeros(n_added, dtype=bool)
        if end.at_start:
            # The added points go away from the strand, and the strand begins with the farthest one.
            points = np.vstack([added[::-1], strand.points])
            bridged = np.concatenate([is_bridged, strand.bridged])
        else:
            points = np.vstack([strand.points, added])
            bridged = np.concatenate([strand.bridged, is_bridged])
        strand = replace(strand, points=points, bridged=bridged)
    return strand


def _classify_end(end: End, unaveraged: NDArray[np.float64], scene: Scene, parameters: ChainParameters) -> EndKind:
    if scene.is_near_border(end.point, parameters.r_f):
        return "unobserved"
    ahead = _distances_ahead(unaveraged, end.point, end.direction, parameters)
    continues = ((ahead > parameters.r_n) & (ahead < parameters.r_cn)).any()
    return "unobserved" if continues else "free"


def _distances_ahead(
    points: NDArray[np.float64],
    origin: NDArray[np.float64],
    direction: NDArray[np.float64],
    parameters: ChainParameters,
) -> NDArray[np.float64]:
    """Return the distances (M,) along a ray of the points within r of the ray, metres.

    The ray starts at `origin` (3,) in `direction` (3,). Points behind the origin are excluded.
    """
    offset = points - origin
    along = offset @ direction
    across = np.linalg.norm(offset - along[:, None] * direction, axis=1)
    return along[(along > 0) & (across < parameters.r)]
