"""The smooth error of a reported pose: its size, its smoothness, and its repeatability for one arm."""

import numpy as np
import pytest
from numpy.typing import NDArray

from calibration.geometry.transforms import from_rotation_vector, inverse, rigid, rotation_angle
from cell.simulation.kinematic_error import KinematicError

RMS_M, RMS_RAD = 0.0006, 0.0026


def pose(rng: np.random.Generator) -> NDArray[np.float64]:
    return from_rotation_vector(rng.uniform(-0.4, 0.4, 3), rng.uniform(-1.5, 1.5, 3))


def test_the_error_has_the_configured_size() -> None:
    rng = np.random.default_rng(0)
    offsets_m, angles_rad = [], []
    for seed in range(200):
        arm = KinematicError(RMS_M, RMS_RAD, seed)
        for _ in range(20):
            T = pose(rng)
            reported = rigid(arm.apply(T), "T")
            offsets_m.append(np.linalg.norm(reported[:3, 3] - T[:3, 3]))
            angles_rad.append(rotation_angle(inverse(T) @ reported))
    # For 200 arms of eight waves, 4 % is about two standard deviations.
    assert np.sqrt(np.mean(np.square(offsets_m))) == pytest.approx(RMS_M, rel=0.06)
    assert np.sqrt(np.mean(np.square(angles_rad))) == pytest.approx(RMS_RAD, rel=0.06)


def test_the_error_is_smooth_and_constant_for_an_arm() -> None:
    rng, arm = np.random.default_rng(1), KinematicError(RMS_M, RMS_RAD, 7)
    for _ in range(50):
        T = pose(rng)
        np.testing.assert_array_equal(arm.apply(T), KinematicError(RMS_M, RMS_RAD, 7).apply(T))
        near = T.copy()
        near[:3, 3] += 0.001
        change_m = np.linalg.norm((arm.apply(near) - near)[:3, 3] - (arm.apply(T) - T)[:3, 3])
        assert change_m < 0.05 * RMS_M  # 1.7 mm farther
    T, other = pose(rng), KinematicError(RMS_M, RMS_RAD, 8)
    assert not np.allclose(arm.apply(T), other.apply(T), atol=1e-5)


def test_an_error_of_size_zero_is_none() -> None:
    T = pose(np.random.default_rng(2))
    np.testing.assert_allclose(KinematicError(0.0, 0.0, 0).apply(T), T, atol=1e-15)
