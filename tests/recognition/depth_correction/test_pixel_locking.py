"""Errors that repeat with each disparity are measured on the table and removed."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from calibration.geometry.transforms import from_rotation_vector
from cell.devices import View
from recognition.depth_correction.pixel_locking import (
    HARMONICS,
    LockingSample,
    PixelLocking,
    correct_locking,
    measure_locking,
    sample_locking,
)
from recognition.preprocessing.table_measurement import measure_table
from recognition.preprocessing.target_cloud import Scene

Image = NDArray[np.float64]

FOCAL_PX = 600.0
BASELINE_M = 0.025
FOCAL_BASELINE = FOCAL_PX * BASELINE_M
PERIOD_PER_M = 1 / FOCAL_BASELINE
SHAPE = (240, 320)
K = np.array([[FOCAL_PX / 2, 0.0, 159.5], [0.0, FOCAL_PX / 2, 119.5], [0.0, 0.0, 1.0]])
"""Matrix of the depth image, which has every second pixel of the camera."""
UNIT_M = 1e-5
"""Depth unit. It is less than 0.002 disparities at the table."""
LOCKING_PX = 0.1
NOISE_PX = 0.1


def pose(tilt_rad: float, turn_rad: float) -> NDArray[np.float64]:
    """Return the pose (4, 4) of a camera that looks at the origin from 0.4 m, tilted about the horizontal axis."""
    # z of the camera points downwards and is tilted; the origin is 0.4 m ahead.
    turn = from_rotation_vector((0.0, 0.0, 0.0), (0.0, 0.0, turn_rad))
    T = turn @ from_rotation_vector((0.0, 0.0, 0.0), (np.pi - tilt_rad, 0.0, 0.0))
    T[:3, 3] = -0.4 * T[:3, 2]
    return T


POSES = tuple(pose(tilt, turn) for tilt, turn in ((0.5, 0.0), (0.3, 1.5), (0.6, 3.0), (0.4, 4.5)))


def disparity(T_base_camera: NDArray[np.float64]) -> Image:
    """Return the exact disparity (H, W) of the table z = 0, pixels."""
    rows, columns = np.indices(SHAPE)
    rays = np.stack([columns, rows, np.ones(SHAPE)], axis=2) @ np.linalg.inv(K).T
    descent = -(rays @ T_base_camera[2, :3])
    return FOCAL_BASELINE * descent / T_base_camera[2, 3]


def view_of(index: int, disparity_px: Image, unit_m: float = UNIT_M) -> View:
    depth = np.rint(FOCAL_BASELINE / disparity_px / unit_m)
    return View(index, depth.astype(np.uint16), unit_m, K, POSES[index], np.eye(4))


def views_with(
    locking_px: float = LOCKING_PX, noise_px: float = NOISE_PX, seed: int = 0, count: int = len(POSES)
) -> list[View]:
    """Return views of the table with pixel locking and white noise of the disparity."""
    rng = np.random.default_rng(seed)
    views = []
    for index, T in enumerate(POSES[:count]):
        true = disparity(T)
        error = locking_px * np.sin(2 * np.pi * true) + rng.normal(0.0, noise_px, SHAPE)
        views.append(view_of(index, true + error))
    return views


def samples_of(views: list[View]) -> list[LockingSample]:
    samples = []
    for view in views:
        plane = measure_table(view, Scene())
        assert plane is not None
        sample = sample_locking(view, plane, Scene())
        assert sample is not None
        samples.append(sample)
    return samples


def measured(views: list[View]) -> PixelLocking:
    locking = measure_locking(samples_of(views))
    assert locking is not None
    return locking


def error_px(view: View) -> Image:
    """Return the error (H, W) of the disparity of a view, pixels."""
    return FOCAL_BASELINE / (view.depth * view.depth_unit_m) - disparity(POSES[view.index])


def corrected(view: View, locking: PixelLocking) -> View:
    """Return the view without pixel locking."""
    result = correct_locking(view, locking)
    return replace(view, depth=result.depth, depth_unit_m=result.depth_unit_m)


def rms_by_phase(view: View, error: Image) -> float:
    """Return the root mean square of the mean error at each of 20 fractions of the true disparity, pixels."""
    fraction = (20 * (disparity(POSES[view.index]) % 1)).astype(np.int64).ravel()
    mean = np.bincount(fraction, error.ravel()) / np.bincount(fraction)
    return float(np.sqrt(np.mean(mean**2)))


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("count", [1, 4])
def test_the_period_is_that_of_the_camera(seed: int, count: int) -> None:
    locking = measured(views_with(seed=seed, count=count))
    # The table spans up to 20 disparities. 0.5 % shifts the phase at the ends, 10 from the middle, by 0.05 periods,
    # which leaves a third of the error there and much less elsewhere.
    assert locking.period_per_m == pytest.approx(PERIOD_PER_M, rel=0.005)


@pytest.mark.parametrize("seed", range(3))
def test_the_correction_halves_the_error(seed: int) -> None:
    views = views_with(noise_px=0.03, seed=seed)
    locking = measured(views)
    for view in views:
        before = error_px(view)
        after = error_px(corrected(view, locking))
        assert rms_by_phase(view, after) < 0.5 * rms_by_phase(view, before)


@pytest.mark.parametrize("seed", range(3))
def test_the_correction_is_the_best_that_noise_allows(seed: int) -> None:
    views = views_with(seed=seed)
    locking = measured(views)
    for view in views:
        before = error_px(view)
        after = error_px(corrected(view, locking))
        # Noise hides the phase. The mean error at each measured phase is the best correction.
        phase = (50 * ((before + disparity(POSES[view.index])) % 1)).astype(np.int64).ravel()
        mean = np.bincount(phase, before.ravel()) / np.bincount(phase)
        best = before.ravel() - mean[phase]
        # The coefficients have noise, and the period is found in steps of 0.1 %: together less than 1 %.
        assert after.std() < 1.01 * best.std()
        assert after.std() < before.std()
        assert rms_by_phase(view, after) < 0.8 * rms_by_phase(view, before)


def test_the_correction_of_an_image_without_noise_leaves_little() -> None:
    views = views_with(noise_px=0.0)
    locking = measured(views)
    for view in views:
        after = error_px(corrected(view, locking))
        assert after.std() < 0.2 * error_px(view).std()


def test_exact_depth_has_no_locking() -> None:
    assert measure_locking(samples_of(views_with(0.0, 0.0))) is None


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("noise_px", [0.1, 0.4])
def test_white_noise_has_no_locking(seed: int, noise_px: float) -> None:
    views = views_with(0.0, noise_px, seed)
    assert measure_locking(samples_of(views)) is None
    assert measure_locking(samples_of(views[:1])) is None


def test_small_locking_is_not_corrected() -> None:
    assert measure_locking(samples_of(views_with(locking_px=0.01))) is None


def test_pixels_without_depth_stay_without_depth() -> None:
    views = views_with()
    locking = measured(views)
    depth = views[0].depth.copy()
    depth[50:60, 70:90] = 0
    holes = correct_locking(replace(views[0], depth=depth), locking)
    np.testing.assert_array_equal(holes.depth > 0, depth > 0)
    empty = correct_locking(replace(views[0], depth=np.zeros_like(depth)), locking)
    assert not empty.depth.any()
    assert empty.depth.shape == SHAPE


def test_a_corrected_image_keeps_its_intensity_image() -> None:
    view = view_of(0, disparity(pose(0.0, 0.0)))
    intensity = np.ones(view.depth.shape, dtype=np.uint8)
    locking = PixelLocking(0.02, np.zeros(2 * len(HARMONICS)), 0.4)
    assert correct_locking(replace(view, intensity=intensity), locking).intensity is intensity


def test_coarse_depth_stays() -> None:
    locking = measured(views_with())
    # 5 mm at 0.4 m is half a disparity. The table is nearer than 0.55 m, where it is a quarter.
    view = view_of(0, disparity(POSES[0]), 0.005)
    assert view.depth.max() * view.depth_unit_m < 0.55
    result = correct_locking(view, locking)
    difference_m = result.depth * result.depth_unit_m - view.depth * view.depth_unit_m
    # The result is rounded to its finer unit, half of which is the largest difference.
    assert np.abs(difference_m).max() <= 0.51 * result.depth_unit_m


def test_no_views_have_no_locking() -> None:
    assert measure_locking([]) is None
