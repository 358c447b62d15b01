"""Occluded points and points over bare table, on made surfaces of r = 10 mm."""

from collections.abc import Callable

import numpy as np
import pytest

from recognition.tracing.occlusion_map import OcclusionMap

R = 0.01
MIDDLE = np.array([(0.0, 0.0, R)])


def on_line(straight: Callable, tube: Callable, z: float, y: float = 0.0, x0: float = -0.05) -> np.ndarray:
    return tube(straight((x0, y, z), (0.05, y, z)), R, 0.0, np.pi)[0]


def occlusion(surface: np.ndarray, points: np.ndarray = MIDDLE) -> list[tuple[bool, bool]]:
    """Return for each point whether it is occluded, and whether it is bare."""
    found = OcclusionMap(surface).occlusion(points, R)
    return list(zip(found.is_occluded.tolist(), found.is_uncovered.tolist(), strict=True))


def test_a_strand_does_not_occlude_itself(straight: Callable, tube: Callable) -> None:
    assert occlusion(on_line(straight, tube, R)) == [(False, False)]


@pytest.mark.parametrize("gap", [1.2, 2.0])
def test_a_strand_on_top_occludes(straight: Callable, tube: Callable, gap: float) -> None:
    # Its top is gap + 1 radii above the point, whether the strand below is seen there or not.
    top = on_line(straight, tube, (1 + gap) * R)
    assert occlusion(top) == [(True, False)]
    assert occlusion(np.vstack([on_line(straight, tube, R), top])) == [(True, False)]


def test_a_strand_beside_occludes_nothing(straight: Callable, tube: Callable) -> None:
    # In contact: the surface that is examined, up to 0.8 r to the side, does not reach it.
    assert occlusion(on_line(straight, tube, R, y=2 * R)) == [(False, True)]
    # On its neighbours, and beside the point: its flank is not over the point.
    assert occlusion(on_line(straight, tube, 2.7 * R, y=2 * R)) == [(False, True)]


def test_the_table_beyond_an_end_is_bare(straight: Callable, tube: Callable) -> None:
    surface = on_line(straight, tube, R, x0=0.0)
    points = np.array([(-0.7, 0, 1), (-0.9, 0, 1), (5.9, 0, 1)]) * R
    assert occlusion(surface, points) == [(False, False), (False, True), (False, True)]


def test_a_single_flying_point_occludes_nothing(straight: Callable, tube: Callable) -> None:
    flying = np.vstack([on_line(straight, tube, R), [(0, 0, 5 * R)]])
    assert occlusion(flying) == [(False, False)]


def test_no_surface_and_no_points() -> None:
    assert occlusion(np.empty((0, 3))) == [(False, True)]
    assert occlusion(MIDDLE, np.empty((0, 3))) == []
