"""What a gripper can run into: strings all along, things but not a string's own noise."""

from collections.abc import Callable

import numpy as np
import pytest
from scipy.spatial import KDTree

from recognition.model import Chain
from recognition.obstacles import VOXEL_M, Obstacles, gather_obstacles

R = 0.004


def chain(number: int, points: np.ndarray, closed: bool = False, r: float = R) -> Chain:
    n = len(points)
    return Chain(number, closed, r, points, np.full(n, 3e-4), np.full(n, 5, dtype=np.int64), ("free", "free"))


def line(y: float = 0.0, length: float = 0.1, count: int = 26) -> np.ndarray:
    return np.column_stack([np.linspace(0, length, count), np.full(count, y), np.full(count, R)])


def things(obstacles: Obstacles) -> np.ndarray:
    return obstacles.points[obstacles.chain < 0]


def plate(x: float, y: float, side: float, z: float) -> np.ndarray:
    """Points every millimetre."""
    n = round(side * 1000) + 1
    a, b = np.meshgrid(x + np.arange(n) / 1000, y + np.arange(n) / 1000)
    return np.column_stack([a.ravel(), b.ravel(), np.full(n * n, z)])


def test_balls_fill_every_string() -> None:
    square = np.array([(0, 0, R), (0.06, 0, R), (0.06, 0.06, R), (0, 0.06, R)])
    found = gather_obstacles((chain(3, line(0.1)), chain(7, square, closed=True, r=0.002)), np.empty((0, 3)))
    assert set(found.chain) == {3, 7}
    for number, r, length in ((3, R, 0.1), (7, 0.002, 0.24)):
        own = found.chain == number
        assert (found.radius_m[own] == r).all()
        s, points = found.s_m[own], found.points[own]
        assert (s[0], s[-1]) == pytest.approx((0, length), abs=1e-12)
        assert np.linalg.norm(np.diff(points, axis=0), axis=1).max() <= r / 2 + 1e-12
    # The closed one's last side is there.
    assert KDTree(found.points[found.chain == 7]).query((0, 0.03, R))[0] < 0.001


def test_every_point_of_a_thing_is_in_a_ball() -> None:
    box = plate(0.02, 0.03, 0.03, 0.02)
    found = gather_obstacles((chain(0, line()),), box)
    balls = things(found)
    assert KDTree(balls).query(box)[0].max() <= found.radius_m[found.chain < 0].max() == VOXEL_M * np.sqrt(3) / 2
    # One a voxel of 1.5 mm: fewer than there are points.
    assert 0 < len(balls) < len(box)
    assert KDTree(box).query(balls)[0].max() <= VOXEL_M


def test_a_strings_own_noise_is_nothing(tube: Callable[..., tuple[np.ndarray, np.ndarray]]) -> None:
    rng = np.random.default_rng(0)
    points, normals = tube(line(count=200), R)
    assert (
        len(things(gather_obstacles((chain(0, line()),), points + rng.normal(0, 0.001, (len(points), 1)) * normals)))
        == 0
    )


def test_lone_points_are_nothing() -> None:
    rng = np.random.default_rng(1)
    flying = rng.uniform((0, 0.02, 0.01), (0.3, 0.3, 0.1), (40, 3))
    assert len(things(gather_obstacles((chain(0, line()),), flying))) == 0


def test_without_strings_everything_is_a_thing() -> None:
    assert len(things(gather_obstacles((), plate(0, 0, 0.02, 0.03)))) > 100
    assert len(gather_obstacles((), np.empty((0, 3))).points) == 0


def test_many_points_are_thinned_first() -> None:
    crowd = np.repeat(plate(0.02, 0.03, 0.03, 0.02), 60, axis=0)
    assert len(crowd) > 50_000
    found = things(gather_obstacles((chain(0, line()),), crowd))
    assert np.ptp(found, axis=0)[:2] == pytest.approx((0.03, 0.03), abs=0.003)
