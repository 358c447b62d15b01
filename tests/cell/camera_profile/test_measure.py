"""The profile of a camera, from synthetic images of a table with known errors."""

import numpy as np
import pytest

from cell.camera_profile.depth_profile import DepthProfile, ProfileError
from cell.camera_profile.measure import PoseImages, measure_profile
from tests.cell.camera_profile.synthetic_table import FOCAL_BASELINE, SIZE, UNIT_M, Errors, K, table_images


def profile_of(errors: Errors, images: int = 5) -> DepthProfile:
    return measure_profile([table_images(errors, images)], FOCAL_BASELINE).profile


def px(profile: DepthProfile, error_m: float | None) -> float:
    assert error_m is not None
    pixels = profile.in_pixels(error_m)
    assert pixels is not None
    return pixels


def test_the_temporal_noise_is_that_of_single_images() -> None:
    profile = profile_of(Errors(temporal=0.1, locking=0.15))
    # The largest 2 % of the variances do not count, which lowers the standard deviation of five images by 4 %.
    assert px(profile, profile.temporal_m) == pytest.approx(0.1, rel=0.08)
    assert (profile.poses, profile.exposures, profile.width, profile.height) == (1, 5, SIZE[1], SIZE[0])
    assert profile.distance_m == pytest.approx(0.45, rel=0.02)


def test_one_image_shows_no_temporal_noise() -> None:
    profile = profile_of(Errors(temporal=0.05), images=1)
    assert profile.temporal_m is None
    assert profile.flicker_share is None
    assert px(profile, profile.ripple_m) == pytest.approx(0.05, rel=0.1)


def test_pixel_locking_gives_the_baseline() -> None:
    profile = measure_profile([table_images(Errors(temporal=0.03, locking=0.15))]).profile
    assert profile.focal_baseline_px_m == pytest.approx(FOCAL_BASELINE, rel=0.005)
    assert px(profile, profile.locking_m) == pytest.approx(0.15, rel=0.1)
    assert profile.rest_m < 0.4 * profile.ripple_m


def test_an_error_of_neighbours_has_a_correlation_length() -> None:
    narrow = profile_of(Errors(fixed=0.1, fixed_blur_px=1.0))
    wide = profile_of(Errors(fixed=0.1, fixed_blur_px=3.0))
    assert narrow.correlation_px is not None
    assert wide.correlation_px is not None
    # The covariance of noise with a blur of s is a Gaussian with s * sqrt(2), half of it is at 1.67 s.
    assert narrow.correlation_px == pytest.approx(1.67, rel=0.2)
    assert wide.correlation_px == pytest.approx(5.0, rel=0.2)
    assert px(wide, wide.rest_m) == pytest.approx(0.1, rel=0.15)


def test_a_slow_error_is_warp_and_no_ripple() -> None:
    profile = profile_of(Errors(temporal=0.03, warp=0.3))
    assert px(profile, profile.warp_m) == pytest.approx(0.3, rel=0.1)
    assert px(profile, profile.ripple_m) < 0.05


def test_holes_and_flicker_are_shares_of_the_table() -> None:
    profile = profile_of(Errors(temporal=0.03, hole_share=0.06))
    assert profile.hole_share == pytest.approx(0.06, abs=0.01)
    assert profile.flicker_share == 0
    profile = profile_of(Errors(temporal=0.03, flicker_share=0.02))
    # A pixel is missing in one of two images, 2 * 0.02 * 0.98.
    assert profile.flicker_share == pytest.approx(0.039, abs=0.006)


def test_edge_holes_are_those_around_an_object() -> None:
    images = table_images(Errors(temporal=0.02))
    depth = images.depth.copy()
    depth[:, 80:120, 100:200] -= int(0.02 / UNIT_M)
    depth[:, 80:120, 200:204] = 0
    profile = measure_profile([PoseImages(depth, UNIT_M, K)]).profile
    assert profile.edge_hole_share is not None
    # 40 rows of 4 pixels, within the ring of 16 pixels around 40x100 pixels.
    assert profile.edge_hole_share == pytest.approx(160 / (56 * 116 - 24 * 84), rel=0.3)
    assert profile.hole_share < 0.01


def test_the_planes_of_all_poses_are_returned() -> None:
    poses = [table_images(Errors(temporal=0.02), tilt=tilt) for tilt in (0.2, -0.1)]
    measurement = measure_profile(poses)
    assert measurement.profile.poses == 2
    for tilt, table in zip((0.2, -0.1), measurement.tables, strict=True):
        # the inverse depth at a pixel is n . K^-1 (u, v, 1)
        ray = np.linalg.inv(K) @ np.array([160.0, 100.0, 1.0])
        assert table.n @ ray == pytest.approx(1 / 0.45, rel=1e-3)
        assert table.n[0] == pytest.approx(tilt / 0.45, abs=0.01)


def test_images_without_a_table_are_rejected() -> None:
    nothing = PoseImages(np.zeros((2, *SIZE), dtype=np.uint16), UNIT_M, K)
    with pytest.raises(ProfileError, match="no image shows a table"):
        measure_profile([nothing])
    with pytest.raises(ProfileError, match="there is no depth image"):
        measure_profile([])
    small = PoseImages(np.full((1, 20, 32), 40000, dtype=np.uint16), UNIT_M, K)
    with pytest.raises(ProfileError, match="differ in size"):
        measure_profile([nothing, small])
    with pytest.raises(ProfileError, match="5000 pixels"):
        measure_profile([small])
