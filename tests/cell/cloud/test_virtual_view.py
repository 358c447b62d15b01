"""Virtual depth images of point clouds."""

import numpy as np
import pytest

from cell.cloud.errors import CloudError
from cell.cloud.virtual_view import look_at, virtual_view

EYE = np.array([0.15, -0.1, 0.4])


def slope(pitch_m: float, seed: int) -> np.ndarray:
    """Return random points (N, 3) of the plane z = 0.1 x."""
    x, y = np.random.default_rng(seed).uniform(-0.1, 0.1, (2, int((0.2 / pitch_m) ** 2)))
    return np.column_stack([x, y, 0.1 * x])


@pytest.mark.parametrize(("per_pixel", "most_m"), [(1.0, 3e-4), (8.0, 1e-4)])
def test_a_slope_does_not_become_steps(per_pixel: float, most_m: float) -> None:
    view = virtual_view(slope(0.001, 0), EYE, per_pixel)
    rows, columns = np.nonzero(view.depth_m)
    rays = np.linalg.inv(view.K) @ np.vstack([columns, rows, np.ones(len(rows))])
    x, _, z = (view.T_base_camera[:3, :3] @ (rays * view.depth_m[rows, columns])) + view.T_base_camera[:3, 3:]
    error = np.abs(z - 0.1 * x)
    assert np.percentile(error, 99) < most_m
    assert np.median(error) < most_m / 10
    assert view.hidden == 0
    assert view.outside == 0


def test_the_pixel_size_follows_the_point_spacing() -> None:
    fine, coarse = (virtual_view(slope(pitch_m, 1), EYE, 1.0).pitch_m for pitch_m in (0.001, 0.002))
    assert 0.0005 < fine < 0.0015
    assert coarse == pytest.approx(2 * fine, rel=0.1)


def test_the_camera_looks_at_its_target() -> None:
    target = np.array([0.1, 0.2, 0.0])
    for eye in (EYE, target + (0, 0, 1), target + (0, 1, 0)):
        T = look_at(eye, target)
        np.testing.assert_allclose(T[:3, :3].T @ T[:3, :3], np.eye(3), atol=1e-12)
        assert np.linalg.det(T[:3, :3]) == pytest.approx(1)
        x, y, z = T[:3, :3].T @ (target - T[:3, 3])
        assert (abs(x) + abs(y), z) == (pytest.approx(0, abs=1e-12), pytest.approx(np.linalg.norm(target - eye)))


def test_a_viewpoint_inside_the_cloud_is_rejected() -> None:
    with pytest.raises(CloudError, match="inside the cloud"):
        virtual_view(slope(0.002, 0), np.array([0.0, 0.0, 0.02]), 1.0)
