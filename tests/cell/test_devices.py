"""A view is checked when it is created."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from calibration.geometry.transforms import NotRigidError, from_rotation_vector, transform_points
from cell.devices import InvalidViewError, View

VIEW = View(
    index=3,
    depth=np.ones((40, 64), dtype=np.uint16),
    depth_unit_m=1e-4,
    K=np.array([[60.0, 0.0, 31.5], [0.0, 61.0, 19.5], [0.0, 0.0, 1.0]]),
    T_base_flange=from_rotation_vector((0.3, 0.1, 0.4), (np.pi, 0.0, 0.0)),
    T_flange_camera=from_rotation_vector((0.05, 0.0, 0.02), (0.0, 0.0, 0.0)),
)


def k_with(row: int, column: int, value: float) -> np.ndarray:
    K = VIEW.K.copy()
    K[row, column] = value
    return K


def test_camera_points_are_transformed_to_the_base_by_the_flange() -> None:
    # The flange is upside down 0.4 m above the base. The camera is 5 cm along its x axis and 2 cm below it.
    seen = transform_points(VIEW.T_base_camera, np.array([[0.0, 0.0, 0.3], [0.0, 0.1, 0.3]]))
    # A few rounding errors of doubles below one metre.
    np.testing.assert_allclose(seen, [[0.35, 0.1, 0.08], [0.35, 0.0, 0.08]], rtol=0, atol=1e-15)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"depth": np.ones((40, 64), dtype=np.float32)}, r"depth is float32 \(40, 64\)"),
        ({"depth": np.ones((40, 64, 1), dtype=np.uint16)}, r"depth is uint16 \(40, 64, 1\)"),
        ({"depth": [[1, 2], [3, 4]]}, "depth is list"),
        ({"depth": np.ones((0, 64), dtype=np.uint16)}, "the depth image is empty"),
        ({"image": np.ones((40, 60), dtype=np.uint8)}, r"picture is uint8 \(40, 60\); uint8 of 64x40"),
        ({"image": np.ones((40, 64), dtype=np.float32)}, r"picture is float32 \(40, 64\)"),
        ({"image": np.ones((40, 64, 4), dtype=np.uint8)}, r"picture is uint8 \(40, 64, 4\)"),
        ({"intensity": np.ones((40, 60), dtype=np.uint8)}, r"intensity image is uint8 \(40, 60\); uint8 of 64x40"),
        ({"intensity": np.ones((40, 64), dtype=np.uint16)}, r"intensity image is uint16 \(40, 64\)"),
        ({"intensity": np.ones((40, 64, 3), dtype=np.uint8)}, r"intensity image is uint8 \(40, 64, 3\)"),
        ({"intensity": [[1, 2], [3, 4]]}, "intensity image is list"),
        ({"depth_unit_m": 0.0}, "depth unit 0.0 m"),
        ({"depth_unit_m": 0.1}, "depth unit 0.1 m"),
        ({"depth_unit_m": float("nan")}, "depth unit nan m"),
        ({"K": np.eye(4)}, "K must be a finite 3x3 matrix"),
        ({"K": k_with(0, 2, np.nan)}, "K must be a finite 3x3 matrix"),
        ({"K": k_with(0, 0, -60)}, "K has focal lengths -60, 61"),
        ({"K": k_with(1, 1, 0)}, "K has focal lengths 60, 0"),
        ({"K": k_with(2, 2, 2)}, r"K is .*, 2.0\]\]; \[\[fx, 0, cx\], \[0, fy, cy\], \[0, 0, 1\]\] is needed"),
        ({"K": k_with(0, 1, 0.5)}, r"K is \[\[60.0, 0.5,"),
        ({"K": k_with(2, 0, 60)}, r"K is "),
        ({"K": k_with(0, 2, 64)}, r"centre at \(64, 19.5\), outside the 64x40 depth image"),
        ({"K": k_with(1, 2, -1)}, r"centre at \(31.5, -1\), outside the 64x40 depth image"),
    ],
)
def test_inconsistent_parts_are_rejected(change: dict[str, Any], message: str) -> None:
    with pytest.raises(InvalidViewError, match=f"view 3: .*{message}"):
        replace(VIEW, **change)


@pytest.mark.parametrize("name", ["T_base_flange", "T_flange_camera"])
@pytest.mark.parametrize("matrix", [np.eye(3), np.diag([1, 1, -1, 1]), np.full((4, 4), np.nan)])
def test_poses_that_are_not_rigid_are_rejected(name: str, matrix: np.ndarray) -> None:
    with pytest.raises(NotRigidError, match=f"view 3: {name}"):
        replace(VIEW, **{name: matrix})


@pytest.mark.parametrize("shape", [(40, 64), (40, 64, 3)])
def test_a_view_may_have_a_picture(shape: tuple[int, ...]) -> None:
    picture = np.arange(np.prod(shape), dtype=np.uint8).reshape(shape)
    assert replace(VIEW, image=picture).image is picture
    assert VIEW.image is None


def test_a_view_may_have_an_intensity_image() -> None:
    intensity = np.arange(40 * 64, dtype=np.uint8).reshape(40, 64)
    assert replace(VIEW, intensity=intensity).intensity is intensity
    assert VIEW.intensity is None
