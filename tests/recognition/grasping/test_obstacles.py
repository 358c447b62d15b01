"""Obstacles for the gripper: strings along their whole length, and objects, but not the noise of a string."""

from collections.abc import Callable

import numpy as np
import pytest
from scipy.spatial import KDTree

from recognition.geometry.polyline import points_at
from recognition.geometry.voxel_grid import voxel_means
from recognition.grasping.obstacles import CELL_M, VOXEL_M, Obstacles, gather_obstacles
from recognition.model.chains import Chain
from recognition.registration.fusion import MAX_POINTS, VOXEL_RADII

R = 0.004
SPACING = VOXEL_RADII * R
RADII = (0.001, 0.0042, 0.012, 0.02)


def chain(number: int, points: np.ndarray, closed: bool = False, r: float = R) -> Chain:
    n = len(points)
    return Chain(number, closed, r, points, np.full(n, 3e-4), np.full(n, 5, dtype=np.int64), ("free", "free"))


def line(y: float = 0.0, length: float = 0.1, count: int = 26) -> np.ndarray:
    return np.column_stack([np.linspace(0, length, count), np.full(count, y), np.full(count, R)])


def object_points(obstacles: Obstacles) -> np.ndarray:
    return obstacles.objects.points


def plate(x: float, y: float, side: float, z: float) -> np.ndarray:
    """Points every millimetre."""
    n = round(side * 1000) + 1
    a, b = np.meshgrid(x + np.arange(n) / 1000, y + np.arange(n) / 1000)
    return np.column_stack([a.ravel(), b.ravel(), np.full(n * n, z)])


def face(side: float, step: float) -> np.ndarray:
    """Points on a tilted square, which cuts the voxels in many directions."""
    a = np.arange(0, side, step)
    u, v = (grid.ravel() for grid in np.meshgrid(a, a))
    along, up = np.array([0.8, 0.6, 0]), np.array([-0.36, 0.48, 0.8])
    return np.array([0.1, 0.1, 0.03]) + u[:, None] * along + v[:, None] * up


def far_plate(count: int, spacing: float) -> np.ndarray:
    """`count` points of a wide plate, a metre away."""
    row = int(np.ceil(np.sqrt(count)))
    u, v = (grid.ravel()[:count] for grid in np.meshgrid(np.arange(row), np.arange(row)))
    return np.column_stack([-1 - spacing * u, spacing * v, np.full(count, 0.1)])


def test_spheres_fill_every_string() -> None:
    square = np.array([(0, 0, R), (0.06, 0, R), (0.06, 0.06, R), (0, 0.06, R)])
    chains = (chain(3, line(0.1)), chain(7, square, closed=True, r=0.002))
    found = gather_obstacles(chains, np.empty((0, 3)), SPACING)
    assert set(found.chain) == {3, 7}
    for number, r, length in ((3, R, 0.1), (7, 0.002, 0.24)):
        own = found.chain == number
        assert (found.radius_m[own] == r).all()
        s, points = found.s_m[own], found.points[own]
        assert (s[0], s[-1]) == pytest.approx((0, length), abs=1e-12)
        assert np.linalg.norm(np.diff(points, axis=0), axis=1).max() <= r / 2 + 1e-12
    # The last side of the closed chain is covered.
    assert KDTree(found.points[found.chain == 7]).query((0, 0.03, R))[0] < 0.001


def test_arc_lengths_are_those_of_the_chain_with_its_corners() -> None:
    # Steps of 3 mm in zigzag: spheres every 1.9 mm cut each corner, and would measure a shorter line.
    k = np.arange(40)
    bent = chain(0, np.column_stack([0.003 * (k // 2 + k % 2), 0.003 * (k // 2), np.full(40, R)]))
    found = gather_obstacles((bent,), np.empty((0, 3)), SPACING)
    assert found.s_m[-1] == pytest.approx(bent.length_m, abs=1e-12)
    assert np.linalg.norm(np.diff(found.points, axis=0), axis=1).sum() < 0.9 * bent.length_m
    np.testing.assert_allclose(points_at(bent.points, found.s_m), found.points, rtol=0, atol=1e-12)


@pytest.mark.parametrize("r", RADII)
def test_every_point_of_a_merged_surface_is_in_a_sphere_for_any_number_of_points(r: float) -> None:
    spacing = VOXEL_RADII * r
    points = face(max(0.02, 3 * r), max(spacing / 8, 1e-4))
    merged, _ = voxel_means(points, spacing)
    spheres = {}
    for count in (0, MAX_POINTS - len(merged)):
        surface = np.vstack([merged, far_plate(count, spacing)])
        found = gather_obstacles((chain(0, line(), r=r),), surface, spacing)
        near = object_points(found)[object_points(found)[:, 0] > 0]
        assert KDTree(near).query(points)[0].max() <= found.objects.radius_m
        # The spheres cover no more than the measured surface, up to their size.
        assert KDTree(points).query(near)[0].max() <= found.objects.radius_m
        spheres[count] = len(near)
    # The other objects have no influence.
    assert len(set(spheres.values())) == 1


@pytest.mark.parametrize(("r", "radius"), [(0.001, 0.0013), (0.0042, 0.0013), (0.012, 0.0035), (0.02, 0.0058)])
def test_spheres_are_no_larger_than_the_spacing_needs(r: float, radius: float) -> None:
    found = gather_obstacles((), face(0.06, VOXEL_RADII * r), VOXEL_RADII * r)
    assert found.objects.radius_m == pytest.approx(radius, abs=5e-5)


def test_a_fine_surface_is_thinned_and_every_point_is_in_a_sphere() -> None:
    box = plate(0.02, 0.03, 0.03, 0.02)
    fine = np.vstack([box, box + (0.0005, 0, 0), box + (0, 0.0005, 0), box + (0.0005, 0.0005, 0)])
    found = gather_obstacles((chain(0, line(), r=0.0015),), fine, 0.0005)
    assert 0 < len(object_points(found)) < len(box)
    assert KDTree(object_points(found)).query(fine)[0].max() <= found.objects.radius_m == VOXEL_M * np.sqrt(3) / 2


def test_objects_are_in_the_order_of_their_cells() -> None:
    found = gather_obstacles((), face(0.06, SPACING), SPACING).objects
    assert found.count.sum() == len(found.points)
    cell = np.repeat(np.arange(len(found.count)), found.count)
    away = np.linalg.norm(found.points - found.centre[cell], axis=1)
    assert (away <= found.extent_m[cell] + 1e-12).all()
    assert found.extent_m.max() <= CELL_M * np.sqrt(3)
    assert len(found.count) < len(found.points) / 10


def test_the_noise_of_a_string_is_no_object(tube: Callable[..., tuple[np.ndarray, np.ndarray]]) -> None:
    rng = np.random.default_rng(0)
    points, normals = tube(line(count=200), R)
    noisy = points + rng.normal(0, 0.001, (len(points), 1)) * normals
    assert len(object_points(gather_obstacles((chain(0, line()),), noisy, SPACING))) == 0


@pytest.mark.parametrize("r", RADII)
def test_isolated_points_are_no_object(r: float) -> None:
    rng = np.random.default_rng(1)
    flying = rng.uniform((0, 0.06, 0.01), (0.3, 0.36, 0.1), (40, 3))
    assert len(object_points(gather_obstacles((chain(0, line(), r=r),), flying, VOXEL_RADII * r))) == 0


def test_without_strings_everything_is_an_object() -> None:
    assert len(object_points(gather_obstacles((), plate(0, 0, 0.02, 0.03), SPACING))) > 100
    nothing = gather_obstacles((), np.empty((0, 3)), SPACING)
    assert len(nothing.points) == len(object_points(nothing)) == len(nothing.objects.count) == 0
