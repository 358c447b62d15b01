"""Fitness of registered views."""

from collections.abc import Callable

import numpy as np
import pytest

from recognition.parameters import ChainParameters
from recognition.preprocessing.normals import NormalCloud
from recognition.registration.registration import transform_cloud
from recognition.registration.view_fitness import MAX_PARTNERS, evaluate_fitness

SHIFT = 0.0004


def views(count: int, seen: Callable, straight: Callable, length: float, r: float) -> list[NormalCloud]:
    """Return views of a string. Each view measured its points at slightly different positions along the string."""
    points, normals = seen([straight((0, 0, r), (length, 0, r))], r)
    rng = np.random.default_rng(0)
    slide = rng.uniform(-0.0005, 0.0005, (count, len(points), 1)) * (1.0, 0.0, 0.0)
    return [NormalCloud(view, points + slide[view], normals, np.eye(4)) for view in range(count)]


@pytest.mark.parametrize("count", [2, MAX_PARTNERS + 1, 3 * MAX_PARTNERS])
@pytest.mark.parametrize("length", [0.1, 1.0, 3.0])
def test_views_that_agree_fit_for_any_length_of_the_string(
    seen: Callable, straight: Callable, table_1: ChainParameters, count: int, length: float
) -> None:
    registered = views(count, seen, straight, length, table_1.r)
    for quality in evaluate_fitness(registered, registered, table_1):
        assert quality.fitness == 1.0
        # The points differ along the string only, and distances are measured across it.
        assert quality.rms_m is not None
        assert quality.rms_m < 1e-6
        assert quality.correction_m == 0


def test_a_view_beside_the_others_has_its_distance(
    seen: Callable, straight: Callable, table_1: ChainParameters
) -> None:
    given = views(4, seen, straight, 0.3, table_1.r)
    T = np.eye(4)
    T[2, 3] = SHIFT
    registered = [transform_cloud(given[0], T), *given[1:]]
    raised, *others = evaluate_fitness(given, registered, table_1)
    assert raised.fitness == 1.0
    assert raised.correction_m == pytest.approx(SHIFT, abs=1e-9)
    assert raised.rms_m is not None
    # The distance is the whole shift at the top and less at the flanks: 0.5 to 0.8 of it as an rms.
    assert 0.5 * SHIFT < raised.rms_m < 0.8 * SHIFT
    assert all(quality.rms_m is not None and quality.rms_m < raised.rms_m / 2 for quality in others)


def test_surface_that_no_other_view_shows_does_not_fit(
    seen: Callable, straight: Callable, table_1: ChainParameters
) -> None:
    half = views(2, seen, straight, 0.2, table_1.r)
    left = half[1].points[:, 0] < 0.1
    cut = NormalCloud(1, half[1].points[left], half[1].normals[left], np.eye(4))
    whole, part = evaluate_fitness([half[0], cut], [half[0], cut], table_1)
    assert whole.fitness == pytest.approx(0.5, abs=0.05)
    assert part.fitness == 1.0
    (alone,) = evaluate_fitness(half[:1], half[:1], table_1)
    assert (alone.fitness, alone.rms_m) == (None, None), "no other view confirms a single view, or contradicts it"
