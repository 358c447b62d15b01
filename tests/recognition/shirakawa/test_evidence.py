"""How many views saw each point, and how far they agree."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from recognition.parameters import ChainParameters
from recognition.preprocessing.normals import NormalCloud
from recognition.shirakawa.evidence import SIGMA_FLOOR_M, point_uncertainty
from recognition.strand import Strand

X = np.arange(0.0, 0.1001, 0.004)


def strand(bridged: np.ndarray | None = None) -> Strand:
    points = np.column_stack([X, np.zeros_like(X), np.full_like(X, 0.0042)])
    return Strand(points, np.zeros(len(X), dtype=bool) if bridged is None else bridged)


def seen_from(tube: Callable, r: float, view: int, x0: float, x1: float, aside_m: float = 0.0) -> NormalCloud:
    """What a view has of the string between x0 and x1, exact but for `aside_m` along y."""
    x = np.arange(x0, x1, 0.0005)
    axis = np.column_stack([x, np.full_like(x, aside_m), np.full_like(x, 0.0042)])
    points, normals = tube(axis, r, 0.0, np.pi)
    return NormalCloud(view, points, normals, np.eye(4))


def test_views_are_counted_point_by_point(table_1: ChainParameters, tube: Callable) -> None:
    r = table_1.r
    clouds = [
        seen_from(tube, r, 0, -0.01, 0.11),
        seen_from(tube, r, 1, -0.01, 0.0501),
        seen_from(tube, r, 2, -0.01, 0.0301),
    ]
    sigma, views = point_uncertainty(strand(), clouds, table_1)
    # A view's centres count within r: up to 30 + 4.2 and 50 + 4.2 mm.
    expected = 1 + (X < 0.0543).astype(int) + (X < 0.0343)
    np.testing.assert_array_equal(views, expected)
    assert np.issubdtype(views.dtype, np.integer)
    # Exact and agreeing views: only the floor is left, where a whole neighbourhood is seen.
    np.testing.assert_allclose(sigma, SIGMA_FLOOR_M, rtol=0, atol=1e-12)


def test_sigma_is_the_spread_of_the_views(table_1: ChainParameters, tube: Callable) -> None:
    clouds = [seen_from(tube, table_1.r, k, -0.01, 0.11, aside_m=a) for k, a in enumerate((0.001, -0.001))]
    sigma, views = point_uncertainty(strand(), clouds, table_1)
    np.testing.assert_array_equal(views, 2)
    # A millimetre to either side, with the floor of 0.2 mm.
    np.testing.assert_allclose(sigma, np.hypot(0.001, SIGMA_FLOOR_M), rtol=0, atol=1e-9)


def test_an_offset_along_the_string_is_no_disagreement(table_1: ChainParameters, tube: Callable) -> None:
    # It ends in the neighbourhood of the last points, so that means lie behind them, but on the line.
    clouds = [seen_from(tube, table_1.r, 0, -0.01, 0.0985)]
    sigma, _ = point_uncertainty(strand(), clouds, table_1)
    np.testing.assert_allclose(sigma, SIGMA_FLOOR_M, rtol=0, atol=1e-12)


def test_bridged_points_have_no_views_and_a_larger_sigma_towards_their_middle(
    table_1: ChainParameters, tube: Callable
) -> None:
    bridged = (X > 0.0399) & (X < 0.0601)
    # A thing that lies 2 r above the string all along the bridged part.
    x, y = np.meshgrid(np.arange(0.038, 0.0621, 0.0005), np.arange(-0.006, 0.0061, 0.0005))
    lid = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, 4 * table_1.r)])
    cloud = seen_from(tube, table_1.r, 0, -0.01, 0.11)
    covered = replace(
        cloud,
        points=np.vstack([cloud.points, lid]),
        normals=np.vstack([cloud.normals, np.tile((0.0, 0.0, 1.0), (len(lid), 1))]),
    )
    sigma, views = point_uncertainty(strand(bridged), [covered], table_1)
    np.testing.assert_array_equal(views, np.where(bridged, 0, 1))
    # 36 and 64 mm are the last seen points on either side.
    gap = np.minimum(X - 0.036, 0.064 - X)[bridged]
    np.testing.assert_allclose(sigma[bridged], SIGMA_FLOOR_M + gap**2 / (10 * table_1.r), rtol=0, atol=1e-9)
    assert sigma[bridged].min() > sigma[~bridged].max()


def test_a_bridge_that_nothing_covers_was_seen(table_1: ChainParameters, tube: Callable) -> None:
    # The over strand of an intersection: bridged there like the other, but in plain sight.
    bridged = (X > 0.0399) & (X < 0.0601)
    sigma, views = point_uncertainty(strand(bridged), [seen_from(tube, table_1.r, 0, -0.01, 0.11)], table_1)
    np.testing.assert_array_equal(views, 1)
    np.testing.assert_allclose(sigma[bridged], SIGMA_FLOOR_M, rtol=0, atol=1e-9)


def test_points_that_no_view_saw_are_known_to_r_only(table_1: ChainParameters, tube: Callable) -> None:
    for clouds in ([], [seen_from(tube, table_1.r, 0, 0.5, 0.6)]):
        sigma, views = point_uncertainty(strand(), clouds, table_1)
        np.testing.assert_array_equal(views, 0)
        np.testing.assert_array_equal(sigma, table_1.r)


def test_a_single_point_is_no_difficulty(table_1: ChainParameters, tube: Callable) -> None:
    alone = Strand(np.array([[0.05, 0.0, 0.0042]]), np.zeros(1, dtype=bool))
    sigma, views = point_uncertainty(alone, [seen_from(tube, table_1.r, 0, 0.0, 0.1)], table_1)
    assert views.tolist() == [1]
    assert np.isfinite(sigma).all()
