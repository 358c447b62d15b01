"""Stages of the two methods of the paper: points are linked to segments, and segments are connected to strands."""

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
    """Segments of one of the two methods."""

    segments: Sequence[NDArray[np.float64]]
    """(N, 3) each, the linked points, metres."""
    thinned: NDArray[np.float64] | None = None
    """(N, 3) thinned points of `enhanced`, metres; None for `matching`."""
    enhanced: EnhancedMatching | None = None
    """Contribution rates and bifurcation centres of `enhanced`; None for `matching`."""


def link_segments(
    method: Literal["matching", "enhanced"], centre_points: NDArray[np.float64], parameters: ChainParameters
) -> LinkedSegments:
    """Link centre points to segments.

    Args:
        method: `"matching"` links all points; `"enhanced"` thins them first and stops at intersections.
        centre_points: (N, 3) means of the centre points (eq. 2), metres.
        parameters: Radii and thresholds.

    Returns:
        The segments, with the thinned points and the measures of `enhanced`.

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
    """Connect the segments of `enhanced` across intersections and gaps, and extend the ends of the strands.

    The segments of `matching` become strands as they are.

    Args:
        linked: Segments by `link_segments`.
        surface: (M, 3) registered surface points, metres.
        unaveraged: (K, 3) centre points (eq. 1), metres.
        parameters: Radii and thresholds.

    Returns:
        The strands, in no particular order or direction, and the strands of `enhanced` after each step of the
        reconstruction; None for `matching`, which connects nothing.

    Raises:
        TooCrowdedError: There are more segments than strings can have.

    Source:
        Section III.E; the extension of the ends is ours.
    """
    if linked.enhanced is None:
        return [Strand(points, np.zeros(len(points), dtype=bool)) for points in linked.segments], None
    reconstruction = reconstruct(linked.segments, linked.enhanced.bifurcation_centres, surface, parameters)
    return extend_ends(reconstruction.connected, unaveraged, parameters), reconstruction
