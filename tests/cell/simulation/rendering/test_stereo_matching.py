import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, shift

from cell.simulation.rendering.stereo_matching import StereoMatching, match

TEXTURE = gaussian_filter(np.random.default_rng(0).standard_normal((60, 200)), 1.2)


def image(columns_px: float) -> NDArray[np.uint8]:
    """Return the texture, moved to the left by a part of a pixel."""
    moved = shift(TEXTURE, (0, -columns_px), order=3, mode="wrap")
    return np.clip(128 + 60 * moved / TEXTURE.std(), 0, 255).astype(np.uint8)


@pytest.mark.parametrize("disparity_px", [5.0, 12.25, 20.6])
def test_a_plane_is_measured_to_a_small_part_of_a_pixel(disparity_px: float) -> None:
    measured = match(image(0), image(disparity_px), 32, StereoMatching())[:, 40:-10]
    assert (measured > 0).mean() > 0.98
    # The cost of OpenCV's matching pulls a disparity towards whole ones by up to 0.3 pixel.
    assert np.median(measured) == pytest.approx(disparity_px, abs=0.3)
    assert np.quantile(np.abs(measured - disparity_px), 0.9) < 0.45


def test_what_only_one_camera_sees_is_not_measured() -> None:
    left = image(0)
    # The first columns of the left image are beyond the right image.
    measured = match(left, np.roll(left, -20, axis=1), 32, StereoMatching())
    assert (measured[:, :15] <= 0).mean() > 0.8


def test_the_disparities_do_not_depend_on_the_threads() -> None:
    threads = cv2.getNumThreads()
    results = []
    for count in (1, 2):
        cv2.setNumThreads(count)
        results.append(match(image(0), image(7.3), 32, StereoMatching()))
    cv2.setNumThreads(threads)
    assert np.array_equal(results[0], results[1])
