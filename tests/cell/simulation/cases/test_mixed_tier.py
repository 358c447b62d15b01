"""Tier `mixed`: strings of different radii that cross."""

import pytest

from cell.simulation.cases import Case, make_case
from cell.simulation.cases.mixed_tier import LENGTH_M, MAX_CROSSINGS, RADIUS_M, THICKER
from cell.simulation.scenes.ground_truth import true_crossings
from cell.simulation.scenes.shapes import polyline_length

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def cases() -> list[Case]:
    return [make_case("mixed", seed) for seed in (0, 1, 2, 3, 8)]


def test_the_given_radius_is_that_of_the_thinnest_string(cases: list[Case]) -> None:
    for case in cases:
        radii_m = case.scene.radii_m
        assert case.scene.radius_m == min(radii_m) == radii_m[0]
        assert RADIUS_M[0] <= case.scene.radius_m <= RADIUS_M[1]
        assert all(
            any(radius_m == pytest.approx(share * case.scene.radius_m) for share in THICKER) for radius_m in radii_m[1:]
        )


def test_the_second_strings_take_the_radii_in_turn(cases: list[Case]) -> None:
    shares = [case.scene.radii_m[1] / case.scene.radius_m for case in cases[:3]]
    assert shares == pytest.approx(THICKER)


def test_strings_have_their_lengths_and_cross(cases: list[Case]) -> None:
    for case in cases:
        lengths_m = [polyline_length(curve) for curve in case.scene.curves]
        assert 2 <= len(lengths_m) <= 3
        assert LENGTH_M[0] - 2e-4 <= min(lengths_m) <= max(lengths_m) <= LENGTH_M[1] + 2e-4
    crossings = [len(true_crossings(case.scene)) for case in cases]
    assert max(crossings) > 1
    assert max(crossings) <= MAX_CROSSINGS
