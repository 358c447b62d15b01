"""An end that runs into another strand's side is an intersection that R_c did not show (r = 10 mm)."""

import numpy as np

from recognition.geometry.polyline import arc_length, close_polyline
from recognition.parameters import ChainParameters
from recognition.shirakawa.reconstruction import reconstruct, split_at_side_contacts
from recognition.strand import Strand

PARAMETERS = ChainParameters.for_radius(0.01)
NO_CENTRES = np.empty((0, 3))


def straight(start_mm: tuple[float, float], end_mm: tuple[float, float]) -> np.ndarray:
    a, b = np.array([*start_mm, 0.0]) / 1000, np.array([*end_mm, 0.0]) / 1000
    return np.linspace(a, b, round(np.linalg.norm(b - a) / 0.01) + 1)


def strand(points: np.ndarray, closed: bool = False) -> Strand:
    return Strand(points, np.zeros(len(points), dtype=bool), closed)


def test_the_passing_strand_is_opened_over_r_cn() -> None:
    passing, ending = strand(straight((-100, 0), (100, 0))), strand(straight((0, 15), (0, 100)))
    opened, centres = split_at_side_contacts([passing, ending], NO_CENTRES, PARAMETERS)
    np.testing.assert_allclose(centres, [(0, 0, 0)], rtol=0, atol=1e-15)
    kept = np.vstack([s.points for s in opened])
    # Of both strands what is nearer than r_cn = 30 mm to the contact is gone, and nothing else.
    everything = np.vstack([passing.points, ending.points])
    expected = everything[np.linalg.norm(everything, axis=1) >= 0.03]
    assert len(opened) == 3
    assert sorted(map(tuple, kept)) == sorted(map(tuple, expected))


def test_an_end_that_passes_by_or_stays_away_is_no_contact() -> None:
    passing = strand(straight((-100, 0), (100, 0)))
    for other in (
        straight((0, 21), (0, 100)),  # farther than r_f
        straight((0, 18), (100, 18)),  # alongside, as near as strings can be
        straight((95, 15), (95, 100)),  # at the other's end
    ):
        strands = [passing, strand(other)]
        opened, centres = split_at_side_contacts(strands, NO_CENTRES, PARAMETERS)
        assert [s is t for s, t in zip(opened, strands, strict=True)] == [True, True]
        assert len(centres) == 0


def test_where_a_string_truly_ends_on_another_the_opening_is_closed_again() -> None:
    segments = [straight((-100, 0), (100, 0)), straight((0, 15), (0, 95))]
    strands = reconstruct(segments, NO_CENTRES, np.vstack(segments), PARAMETERS).connected
    spans = sorted((round(float(np.ptp(s.points[:, 0])), 3), round(float(np.ptp(s.points[:, 1])), 3)) for s in strands)
    # The ending strand, from 35 mm on, is the odd end; the other is whole again.
    assert spans == [(0.0, 0.06), (0.2, 0.0)]


def test_a_sequence_that_turned_into_the_other_strand_is_corrected() -> None:
    # It came from the left and continued upwards; the rest of both strands ends at its side.
    turned = np.vstack([straight((-100, 0), (-10, 0)), straight((0, 10), (0, 100))])
    rest = [straight((12, 0), (100, 0)), straight((0, -12), (0, -100))]
    strands = reconstruct([turned, *rest], NO_CENTRES, np.vstack([turned, *rest]), PARAMETERS).connected
    spans = sorted((round(float(np.ptp(s.points[:, 0])), 2), round(float(np.ptp(s.points[:, 1])), 2)) for s in strands)
    assert spans == [(0.0, 0.2), (0.2, 0.0)]


def test_a_loop_on_whose_side_a_string_ends_is_closed_again() -> None:
    # All round but for 9 mm, which are bridged at first; the other string ends on the side away from there.
    angle = np.linspace(0.03, 2 * np.pi - 0.03, 94)
    ring = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(94)]) * 0.15
    segments = [ring, straight((-165, 0), (-250, 0))]
    strands = reconstruct(segments, NO_CENTRES, np.vstack(segments), PARAMETERS).connected
    assert sorted(s.closed for s in strands) == [False, True]
    (closed,) = (s for s in strands if s.closed)
    # Once round; ends' directions are chords, so that the bridge over the opening is a little longer.
    around = arc_length(close_polyline(closed.points, closed=True))[-1]
    assert abs(around - 2 * np.pi * 0.15) < 0.01
