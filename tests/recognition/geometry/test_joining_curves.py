import numpy as np
import pytest

from recognition.geometry.joining_curves import first_crossings, joining_curves


@pytest.mark.parametrize("turn", [0.3, 1.0, 2.0])
def test_an_arc_is_joined_with_its_length_and_energy(turn: float) -> None:
    radius = 0.02
    end = radius * np.array([[np.sin(turn), 1 - np.cos(turn), 0.0]])
    arriving = np.array([[np.cos(turn), np.sin(turn), 0.0]])
    curves = joining_curves(np.zeros((1, 3)), np.array([[1.0, 0.0, 0.0]]), end, arriving)
    assert curves.length[0] == pytest.approx(radius * turn, rel=0.01)
    assert curves.energy[0] == pytest.approx(turn / radius, rel=0.02)
    np.testing.assert_allclose(np.linalg.norm(curves.points[0] - (0, radius, 0), axis=1), radius, rtol=0.01)


def test_the_crossings_of_curves_are_found() -> None:
    x = np.linspace(0, 1, 6)
    rising, falling = np.column_stack([x, x, x]), np.column_stack([x, 0.5 - x, 0 * x])
    crosses, on_one, on_other = first_crossings(np.array([rising, rising]), np.array([falling, rising + (0, 0.1, 0)]))
    assert crosses.tolist() == [True, False]
    np.testing.assert_allclose((on_one[0], on_other[0]), [(0.25, 0.25, 0.25), (0.25, 0.25, 0)], rtol=0, atol=1e-9)
    assert len(first_crossings(np.empty((0, 6, 3)), np.empty((0, 6, 3)))[0]) == 0


def test_shorter_tangents_give_narrower_curves_of_more_energy() -> None:
    # A half circle of radius 1 bulges by 1. The cubic with the tangents of an arc exceeds it by 4 %.
    start, end = np.zeros((1, 3)), np.array([[0.0, 2.0, 0.0]])
    x = np.array([[1.0, 0.0, 0.0]])
    arc, narrow = (joining_curves(start, x, end, -x, fullness) for fullness in (1.0, 0.6))
    assert arc.points[0, :, 0].max() == pytest.approx(1.0, abs=0.05)
    assert narrow.points[0, :, 0].max() == pytest.approx(0.6, abs=0.05)
    assert narrow.length[0] < arc.length[0]
    assert narrow.energy[0] > arc.energy[0]
