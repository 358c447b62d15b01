import numpy as np
import pytest

from recognition.tracing.bending_energy import joining_energy


def arc_ends(radius: float, turn: float) -> tuple[np.ndarray, ...]:
    """Return chord, leaving and arriving direction, and the curvatures of both ends of an arc in the plane."""
    chord = radius * np.array([np.sin(turn), 1 - np.cos(turn), 0.0])
    leaving, arriving = np.array([1.0, 0.0, 0.0]), np.array([np.cos(turn), np.sin(turn), 0.0])
    k_a, k_b = np.array([0.0, 1.0, 0.0]) / radius, np.array([-np.sin(turn), np.cos(turn), 0.0]) / radius
    return tuple(v[None] for v in (chord, leaving, arriving, k_a, k_b))


@pytest.mark.parametrize("turn", [0.2, 0.6, 1.0])
def test_an_arc_has_the_energy_of_its_curvature(turn: float) -> None:
    chord, leaving, arriving, k_a, _ = arc_ends(0.02, turn)
    energy = joining_energy(chord, leaving, arriving, 0 * k_a, 0 * k_a)
    # the chord is shorter than the arc by 4 % at 1 rad
    assert energy[0] == pytest.approx(0.02 * turn / 0.02**2, rel=0.05)


@pytest.mark.parametrize("turn", [0.2, 0.6, 1.0])
def test_ends_that_continue_an_arc_need_no_energy(turn: float) -> None:
    arc = arc_ends(0.02, turn)
    assert joining_energy(*arc)[0] < 0.03 * joining_energy(*arc[:3], 0 * arc[3], 0 * arc[4])[0]


def test_a_bend_to_the_other_side_needs_more_energy_than_one_to_the_same_side() -> None:
    chord, leaving, arriving, k_a, k_b = arc_ends(0.02, 0.8)
    assert (
        joining_energy(chord, leaving, arriving, -k_a, -k_b)[0] > joining_energy(chord, leaving, arriving, k_a, k_b)[0]
    )


def test_the_energy_is_that_of_the_cubic_between_the_ends() -> None:
    a, b, length = 0.05, 0.03, 0.1
    t = np.linspace(0, 1, 2001)
    y = length * (a * (t - 2 * t**2 + t**3) + b * (t**3 - t**2))
    bent = np.gradient(np.gradient(y, t * length), t * length)
    expected = np.trapezoid(bent**2, t * length)
    zero = np.zeros((1, 3))
    energy = joining_energy(np.array([[length, 0, 0]]), np.array([[1, a, 0]]), np.array([[1, b, 0]]), zero, zero)
    assert energy[0] == pytest.approx(expected, rel=0.01)
