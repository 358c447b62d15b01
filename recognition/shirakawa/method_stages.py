"""The two stages of the paper's methods: link points to segments, then connect segments to strands."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from recognition.parameters import ChainParameters
from recognition.shirakawa.end_extension import extend_ends
from recognition.shirakawa.enhanced_matching import EnhancedMatching, match_enhanced, thin
from recognition.shirakawa.matching import match_points
from recognition.shirakawa.reconstruction import Reconstruction, reconstruct
from recognition.strand import Strand


@dataclass(frozen=True, eq=False)
class LinkedSegments:
    """Result of `link_segments`."""

    segments: Sequence[NDArray[np.float64]]
    """(N, 3) linked points of each segment, metres, base frame."""
    thinned: NDArray[np.float64] | None = None
    """(N, 3) thinned points of `enhanced`, metres; None for `matching`."""
    enhanced: EnhancedMatching | None = None
    """Result of the enhanced matching; None for `matching`."""


def link_segments(
    method: Literal["matching", "enhanced"], centre_points: NDArray[np.float64], parameters: ChainParameters
) -> LinkedSegments:
    """Link centre points to segments.

    Args:
        method: `"matching"` links all points. `"enhanced"` thins the points first, and stops segments at
            intersections.
        centre_points: (N, 3) means of the centre points (eq. 2), metres.
        parameters: Method parameters; `"matching"` uses r_n and r_f, `"enhanced"` uses all except r and z_t.

    Returns:
        The segments. For `"enhanced"` also the thinned points and the result of the enhanced matching.

    Source:
        Section II.G for `"matching"`; sections III.B to III.D for `"enhanced"`.
    """
    if method == "matching":
        return LinkedSegments([centre_points[segment] for segment in match_points(centre_points, parameters)])
    thinned = thin(centre_points, parameters)
    enhanced = match_enhanced(thinned, parameters)
    return LinkedSegments([thinned[segment] for segment in enhanced.segments], thinned, enhanced)


def connect_segments(
    linked: LinkedSegments,
    surface: NDArray[np.float64],
    unaveraged: NDArray[np.float64],
    parameters: ChainParameters,
) -> tuple[list[Strand], Reconstruction | None]:
    """Connect segments to strands across intersections and gaps, and extend the ends of the strands.

    The segments of `matching` become strands without any change.

    Args:
        linked: Segments from `link_segments`.
        surface: (M, 3) registered surface points, metres.
        unaveraged: (K, 3) centre points (eq. 1), metres.
        parameters: Method parameters; uses r, r_n, r_f, r_cn and r_cf.

    Returns:
        The strands, in no particular order or direction, and the reconstruction. The reconstruction is None for
        `matching`.

    Raises:
        TooCrowdedError: The number of segments exceeds `MAX_SEGMENTS` of `reconstruction`.

    Source:
        Section III.E. The extension of the ends is not in the paper.
    """
    if linked.enhanced is None:
        return [Strand(points, np.zeros(len(points), dtype=bool)) for points in linked.segments], None
    reconstruction = reconstruct(linked.segments, linked.enhanced.bifurcation_centres, surface, parameters)
    return extend_ends(reconstruction.connected, unaveraged, parameters), reconstruction
