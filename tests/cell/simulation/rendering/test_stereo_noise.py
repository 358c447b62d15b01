"""The parameters of the noise model, measured on flat depth images of half a megapixel.

With that many pixels, the sampling error of a spread is below 1 % and that of a share below 0.2 %.
"""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from cell.simulation.rendering.depth_camera import CAMERAS
from cell.simulation.rendering.stereo_noise import (
    MEDIAN_OF_FIVE,
    StereoNoise,
    device_warp,
    drop_pixels,
    expose,
    still_image,
)

pytestmark = pytest.mark.slow

NONE = StereoNoise(
    800.0, 0.05, wave_px=0, fixed_px=0, frame_px=0, step_px=1e-6, hole_share=0, jitter_px=0, flying_share=0
)
SHAPE = (600, 900)
WALL = np.full(SHAPE, 0.4, dtype=np.float32)
DISPARITY = 800.0 * 0.05 / 0.4


def measure(
    depth: NDArray[np.float32], focal_px: float, noise: StereoNoise, bias_px: float, rng: np.random.Generator
) -> NDArray[np.float32]:
    return expose(still_image(depth, focal_px, noise, bias_px, rng), noise, rng, MEDIAN_OF_FIVE)


def disparity_error(noise: StereoNoise, bias_px: float = 0.0, depth: NDArray = WALL) -> NDArray[np.float64]:
    measured = measure(depth, 800.0, noise, bias_px, np.random.default_rng(1)).astype(np.float64)
    assert np.isfinite(measured).all()
    return (40.0 / measured - 40.0 / depth)[measured > 0]


def test_without_noise_the_depth_is_unchanged() -> None:
    assert np.abs(measure(WALL, 800.0, NONE, 0.0, np.random.default_rng(0)) - WALL).max() < 1e-6


def test_the_bias_shifts_every_disparity() -> None:
    assert np.abs(disparity_error(NONE, bias_px=0.2) - 0.2).max() < 1e-3


def test_the_spreads_are_those_of_the_model() -> None:
    assert disparity_error(replace(NONE, fixed_px=0.12)).std() == pytest.approx(0.12, rel=0.02)
    assert disparity_error(replace(NONE, frame_px=0.09)).std() == pytest.approx(0.09 * MEDIAN_OF_FIVE, rel=0.02)


def test_the_median_of_five_has_its_smaller_spread() -> None:
    samples = np.random.default_rng(0).standard_normal((100_000, 5))
    assert np.median(samples, axis=1).std() == pytest.approx(MEDIAN_OF_FIVE, rel=0.01)


def test_fixed_noise_is_correlated_over_three_pixels() -> None:
    error = disparity_error(replace(NONE, fixed_px=0.12)).reshape(SHAPE)
    alike = [np.corrcoef(error[:, :-k].ravel(), error[:, k:].ravel())[0, 1] for k in (1, 2, 3, 5)]
    # exp(-k^2 / 4) is the correlation of a Gaussian of one pixel.
    assert alike == pytest.approx([0.78, 0.37, 0.11, 0.0], abs=0.03)


def test_the_disparity_error_is_periodic_in_whole_pixels() -> None:
    quarter = np.full(SHAPE, 40.0 / (DISPARITY + 0.25), dtype=np.float32)
    waving = replace(NONE, wave_px=0.1)
    assert np.abs(disparity_error(waving)).max() < 2e-3
    assert np.abs(disparity_error(waving, depth=quarter) - 0.1).max() < 2e-3


def test_disparities_are_rounded() -> None:
    ramp = np.linspace(0.3, 0.5, SHAPE[1], dtype=np.float32) * np.ones(SHAPE, dtype=np.float32)
    measured = measure(ramp, 800.0, replace(NONE, step_px=1 / 32), 0.0, np.random.default_rng(0))
    steps = 40.0 / measured.astype(np.float64) * 32
    assert np.abs(steps - np.rint(steps)).max() < 0.01
    assert np.abs(disparity_error(replace(NONE, step_px=1 / 32), depth=ramp)).max() <= 0.5 / 32 + 1e-4


def test_error_in_metres_grows_with_the_square_of_the_distance() -> None:
    noisy = replace(NONE, fixed_px=0.12)
    spreads = []
    for z in (0.3, 0.6):
        wall = np.full(SHAPE, z, dtype=np.float32)
        spreads.append(measure(wall, 800.0, noisy, 0.0, np.random.default_rng(0)).std())
    assert spreads[1] / spreads[0] == pytest.approx(4.0, rel=0.02)


def test_holes_have_their_share_and_are_connected() -> None:
    holes = measure(WALL, 800.0, replace(NONE, hole_share=0.05), 0.0, np.random.default_rng(0)) == 0
    assert holes.mean() == pytest.approx(0.05, abs=0.004)
    assert holes[:, 1:][holes[:, :-1]].mean() > 0.4


def test_the_band_left_of_a_foreground_object_is_not_measured() -> None:
    step = np.full((40, 200), 0.5, dtype=np.float32)
    step[:, 100:150] = 0.4
    measured = measure(step, 800.0, NONE, 0.0, np.random.default_rng(0))
    # Disparities 100 and 80 give a band of 20 pixels left of column 100 and none on the right.
    assert [int(columns) for columns in (measured == 0).sum(axis=1)] == pytest.approx([20] * 40, abs=1)
    assert (measured[:, 82:99] == 0).all()
    # At half the resolution, the band is half as wide.
    measured = measure(step, 400.0, NONE, 0.0, np.random.default_rng(0))
    assert [int(columns) for columns in (measured == 0).sum(axis=1)] == pytest.approx([10] * 40, abs=1)


def test_only_rims_have_edge_noise() -> None:
    # A slanted plane has no rim, because its disparity is linear in the image.
    v, u = np.indices(SHAPE)
    plane = (1 / (2.0 + 0.001 * u + 0.002 * v)).astype(np.float32)
    rough = replace(NONE, jitter_px=1.0, flying_share=0.5)
    assert np.abs(measure(plane, 800.0, rough, 0.0, np.random.default_rng(0)) - plane).max() < 2e-5
    step = np.full(SHAPE, 0.5, dtype=np.float32)
    step[:, :450] = 0.45
    moved = np.abs(measure(step, 800.0, rough, 0.0, np.random.default_rng(0)) - step) > 1e-3
    assert 0 < np.flatnonzero(moved.any(axis=0)).min() >= 447
    assert np.flatnonzero(moved.any(axis=0)).max() <= 453


def test_flying_pixels_lie_between_front_and_back() -> None:
    step = np.full(SHAPE, 0.5, dtype=np.float32)
    step[:, :450] = 0.45
    measured = measure(step, 800.0, replace(NONE, flying_share=0.3), 0.0, np.random.default_rng(0))
    between = (measured > 0.4505) & (measured < 0.4995)
    # Two columns are rims.
    assert between.sum() / (2 * SHAPE[0]) == pytest.approx(0.3, abs=0.05)
    assert measured.min() >= 0.45 - 1e-5
    assert measured.max() <= 0.5 + 1e-5


def test_an_empty_scene_has_no_measurement() -> None:
    empty = np.full((20, 30), np.inf, dtype=np.float32)
    assert (measure(empty, 800.0, StereoNoise(800.0, 0.05), 0.0, np.random.default_rng(0)) == 0).all()


MEASURED = replace(NONE, warp_px=0.3, edge_hole_share=0.15, flicker_share=0.25)
STEP = np.where(np.arange(900) < 450, np.float32(0.4), np.float32(0.5))[None].repeat(600, axis=0)


def test_each_device_has_its_own_slow_warp() -> None:
    warps = [device_warp(MEASURED, SHAPE, np.random.default_rng(seed)) for seed in (1, 1, 2)]
    first, again, other = (warp.astype(np.float64) for warp in warps if warp is not None)
    np.testing.assert_array_equal(first, again)
    assert abs(np.corrcoef(first.ravel(), other.ravel())[0, 1]) < 0.9
    assert np.sqrt(np.mean(first**2)) == pytest.approx(0.3, rel=1e-5)
    assert abs(first.mean()) < 1e-4
    # Three half periods across 900 pixels change by at most 3 pi / 900 of the amplitude per pixel.
    assert np.abs(np.diff(first, axis=1)).max() < 0.02
    assert device_warp(NONE, SHAPE, np.random.default_rng(1)) is None


def test_the_warp_is_in_every_image_of_the_device() -> None:
    warp = device_warp(MEASURED, SHAPE, np.random.default_rng(1))
    assert warp is not None
    still = still_image(WALL, 800.0, NONE, 0.0, np.random.default_rng(0), warp)
    np.testing.assert_allclose(still.disparity - DISPARITY, warp, atol=1e-4)


def test_pixels_beside_a_rim_are_lost_and_flicker() -> None:
    rng = np.random.default_rng(3)
    plain = still_image(STEP, 800.0, NONE, 0.0, np.random.default_rng(0))
    still = still_image(STEP, 800.0, MEASURED, 0.0, rng)
    columns = np.arange(900)
    ring = (columns >= 442) & (columns <= 457)  # the two columns of the rim and eight on each side, without their ends
    lost = plain.good & ~still.good
    assert not lost[:, (columns < 440) | (columns > 460)].any()
    # 600 x 16 pixels with correlated noise are about 1,000 independent ones, so 4 % are three standard deviations.
    assert lost[:, ring][plain.good[:, ring]].mean() == pytest.approx(0.15, abs=0.04)
    assert still.flickering is not None
    assert still.flickering[:, ring].mean() == pytest.approx(0.25, abs=0.05)
    frames = np.stack([expose(still, MEASURED, rng) > 0 for _ in range(20)])
    steady = still.good & ~still.flickering
    assert frames[:, steady].all()
    assert frames[:, still.good & still.flickering].mean() == pytest.approx(0.5, abs=0.02)


def test_weak_texture_gives_smooth_patches_within_their_limit() -> None:
    noise = replace(NONE, patches=4.0, patch_px=10.0)
    errors = [
        still_image(WALL, 800.0, noise, 0.0, np.random.default_rng(seed)).disparity - np.float32(DISPARITY)
        for seed in range(8)
    ]
    peaks = [np.abs(error).max() for error in errors]
    assert 3.0 < max(peaks) <= 12.0  # two patches may meet
    # A Gaussian of half the radius changes by at most 10 px * 1.2 / 6 between neighbouring pixels.
    assert max(np.abs(np.diff(error, axis=1)).max() for error in errors) < 2.0
    assert 0.9 < np.mean([np.abs(error) < 0.5 for error in errors]) < 0.999


def test_presets_without_measured_errors_have_none_of_these_errors() -> None:
    for name in ("ideal-sr", "ideal"):
        noise = CAMERAS[name].noise
        assert noise is not None
        assert (noise.warp_px, noise.edge_hole_share, noise.flicker_share, noise.patches) == (0, 0, 0, 0)
    assert still_image(WALL, 800.0, StereoNoise(800.0, 0.05), 0.0, np.random.default_rng(0)).flickering is None


@pytest.mark.parametrize("blobs", [False, True])
def test_only_strings_lose_a_share_of_their_pixels(blobs: bool) -> None:
    noise = StereoNoise(800.0, 0.075, string_dropout_share=0.4, string_dropout_blobs=blobs)
    still = still_image(WALL, 400.0, noise, 0.0, np.random.default_rng(1))
    is_string = np.zeros(WALL.shape, dtype=bool)
    is_string[:, : WALL.shape[1] // 2] = True
    dropped = drop_pixels(still, is_string, noise, np.random.default_rng(2))
    lost = still.good & ~dropped.good
    assert not lost[~is_string].any()
    assert lost.sum() / (still.good & is_string).sum() == pytest.approx(0.4, abs=0.03)
    side_by_side = np.corrcoef(dropped.good[:, 100:130].ravel(), dropped.good[:, 101:131].ravel())[0, 1]
    assert side_by_side > 0.4 if blobs else abs(side_by_side) < 0.1


def test_a_model_without_dropouts_draws_nothing_for_them() -> None:
    noise = StereoNoise(800.0, 0.075)
    still = still_image(WALL, 400.0, noise, 0.0, np.random.default_rng(1))
    rng = np.random.default_rng(2)
    assert drop_pixels(still, np.ones(WALL.shape, dtype=bool), noise, rng) is still
    assert rng.random() == np.random.default_rng(2).random()


def test_a_scaled_model_has_a_multiple_of_each_error() -> None:
    noise = CAMERAS["ideal-measured"].noise
    assert noise is not None
    assert noise.scaled(1.0) == noise
    scaled = noise.scaled(4.0)
    assert (scaled.fixed_px, scaled.warp_px) == (4 * noise.fixed_px, 4 * noise.warp_px)
    assert (scaled.flicker_share, scaled.hole_share) == (0.45, 4 * noise.hole_share)
    assert (scaled.patch_px, scaled.baseline_m) == (noise.patch_px, noise.baseline_m)
