"""Occluded points and points over bare table, on made surfaces of r = 10 mm."""

from collections.abc import Callable

import numpy as np
import pytest

from cell.devices import View
from recognition.preprocessing.normals import NormalCloud
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


def view_from(x: float, wall_m: float) -> NormalCloud:
    """Return a view from 0.4 m above (x, 0), straight down, that measured a wall of this height at y < 0."""
    T = np.eye(4)
    T[:3, :3] = np.array([(1, 0, 0), (0, -1, 0), (0, 0, -1)])
    T[:3, 3] = x, 0.0, 0.4
    depth = np.full((200, 320), 4000, dtype=np.uint16)
    depth[100:] = round((0.4 - wall_m) * 1e4)  # the lower half of the image is y < 0
    depth[:, :10] = 0
    K = np.array([[400.0, 0.0, 160.0], [0.0, 400.0, 100.0], [0.0, 0.0, 1.0]])
    image = View(index=0, depth=depth, depth_unit_m=1e-4, K=K, T_base_flange=T, T_flange_camera=np.eye(4))
    return NormalCloud(0, np.zeros((1, 3)), np.array([(0.0, 0.0, 1.0)]), np.eye(4), T, image)


@pytest.mark.parametrize(
    ("views", "expected"),
    [
        ([view_from(0.0, 0.06)], [(True, False), (False, True), (False, True)]),
        ([view_from(0.0, 0.06), view_from(0.02, 0.06)], [(True, False), (False, True), (False, True)]),
        ([view_from(0.0, 0.06), view_from(0.02, 0.0)], [(False, True), (False, True), (False, True)]),
        # The surface of the point's own strand does not hide it.
        ([view_from(0.0, 2 * R)], [(False, True), (False, True), (False, True)]),
        ([], [(False, True), (False, True), (False, True)]),
    ],
    ids=["one view", "both views", "the other view sees it", "own surface", "no view"],
)
def test_a_point_that_all_views_saw_something_before_is_hidden(
    straight: Callable, tube: Callable, views: list[NormalCloud], expected: list[tuple[bool, bool]]
) -> None:
    far = on_line(straight, tube, R, y=0.5)
    # Behind the wall, beside it, and where nothing was measured.
    points = np.array([(0.0, -0.05, R), (0.0, 0.05, R), (-0.15, -0.05, R)])
    found = OcclusionMap(far, views).occlusion(points, R)
    assert list(zip(found.is_occluded.tolist(), found.is_uncovered.tolist(), strict=True)) == expected
