"""The stages of both methods of the paper, on a straight centre line and on two lines with a gap between them."""

import numpy as np

from recognition.parameters import ChainParameters
from recognition.shirakawa.method_stages import connect_segments, link_segments

PARAMETERS = ChainParameters.for_radius(0.01)
NO_SURFACE = np.empty((0, 3))


def line(start_mm: float, end_mm: float) -> np.ndarray:
    """Points 1 mm apart along x."""
    x = np.arange(start_mm, end_mm + 1) / 1000
    return np.column_stack([x, np.zeros_like(x), np.full_like(x, 0.01)])


def test_matching_gives_one_strand_for_each_segment_without_thinning_or_reconstruction() -> None:
    points = line(0, 200)
    linked = link_segments("matching", points, PARAMETERS)
    assert (linked.thinned, linked.enhanced) == (None, None)
    (segment,) = linked.segments
    strands, reconstruction = connect_segments(linked, NO_SURFACE, points, PARAMETERS)
    assert reconstruction is None
    (strand,) = strands
    np.testing.assert_array_equal(strand.points, segment)
    assert not strand.bridged.any()


def test_enhanced_thins_the_points_and_extends_the_strand_to_the_ends() -> None:
    points = line(0, 200)
    linked = link_segments("enhanced", points, PARAMETERS)
    assert linked.thinned is not None
    assert linked.thinned.shape == points.shape
    assert linked.enhanced is not None
    assert linked.enhanced.bifurcation_centres.shape == (0, 3)
    (segment,) = linked.segments
    strands, reconstruction = connect_segments(linked, NO_SURFACE, points, PARAMETERS)
    assert reconstruction is not None
    assert len(reconstruction.reconnected) == len(reconstruction.connected) == 1
    (strand,) = strands
    # Thinning draws the ends of the segment inwards; the centre points reach the ends of the line.
    assert np.ptp(segment[:, 0]) < np.ptp(strand.points[:, 0]) <= 0.2


def test_only_enhanced_connects_segments_across_a_hidden_gap() -> None:
    # Over the gap of 40 mm lies a strand along y.
    points = np.vstack([line(0, 100), line(140, 240)])
    y = np.arange(-60, 61) / 1000
    over = np.column_stack([np.full_like(y, 0.12), y, np.full_like(y, 0.04)])
    surface = np.vstack([points + (0, 0, 0.01), over])
    counts = []
    for method in ("matching", "enhanced"):
        linked = link_segments(method, points, PARAMETERS)
        counts.append((len(linked.segments), len(connect_segments(linked, surface, points, PARAMETERS)[0])))
    assert counts == [(2, 2), (2, 1)]
