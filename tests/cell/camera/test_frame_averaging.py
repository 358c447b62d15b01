import pickle
import time
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray

from cell.camera.frame_averaging import Exposure, NoFramesError, Picture, combine, median, wait_for_exposures
from cell.errors import BadFrameError

K = np.array([[400.0, 0, 31.5], [0, 400.0, 19.5], [0, 0, 1]])


def image(*rows: list[int]) -> NDArray[np.uint16]:
    return np.array(rows, dtype=np.uint16)


def plane(offset: int = 0) -> NDArray[np.uint16]:
    return (4000 + offset + np.indices((40, 64)).sum(axis=0)).astype(np.uint16)


def every(period_s: float, began_s: Callable[[float], float]) -> Callable[[float], Exposure | None]:
    """Return a camera that sends an image after each period. `began_s` maps the true to the reported time."""

    def receive(wait_s: float) -> Exposure | None:
        time.sleep(min(wait_s, period_s))
        return Exposure(plane(), K, began_s(time.monotonic())) if wait_s >= period_s else None

    return receive


def test_the_median_ignores_pixels_without_a_measurement() -> None:
    stack = [
        image([10, 0, 7, 0]),
        image([30, 5, 0, 0]),
        image([20, 9, 9, 4]),
        image([50, 8, 9, 0]),
        image([40, 0, 8, 6]),
    ]
    # 5 of 5; 5, 8, 9 of 5; 7, 8, 9, 9: the nearer of the middle two; two of five are not a majority.
    assert median(stack).tolist() == [[30, 8, 8, 0]]


def test_half_is_not_a_majority() -> None:
    assert median([image([5]), image([0])]).tolist() == [[0]]
    assert median([image([5]), image([7]), image([0]), image([0])]).tolist() == [[0]]
    assert median([image([5]), image([7]), image([6]), image([0])]).tolist() == [[6]]


@given(st.integers(1, 9).flatmap(lambda n: arrays(np.uint16, (n, 3, 4), elements=st.integers(0, 6))))
def test_the_median_is_that_of_the_measurements_of_each_pixel(stack: NDArray[np.uint16]) -> None:
    result = median(list(stack))
    for v, u in np.ndindex(result.shape):
        measured = sorted(int(d) for d in stack[:, v, u] if d)
        expected = measured[(len(measured) - 1) // 2] if 2 * len(measured) > len(stack) else 0
        assert result[v, u] == expected


def test_a_frame_has_the_median_and_the_start_of_the_last_exposure() -> None:
    began = time.monotonic()
    frame = combine([Exposure(plane(k), K, began - 5 + k) for k in (0, 2, 1)], 0.0001)
    assert np.array_equal(frame.depth, plane(1))
    assert (frame.exposures, frame.depth_unit_m) == (3, 0.0001)
    assert np.array_equal(frame.K, K)
    # The two clocks are read one after the other.
    assert frame.stamp_s == pytest.approx(time.time() - (time.monotonic() - began) - 4, abs=0.05)


@pytest.mark.parametrize(
    ("depth", "reason"),
    [
        (np.zeros((40, 64), np.uint16), "all zero"),
        (np.full((40, 64), 5000, np.uint16), "same depth at all measured pixels .5000 counts."),
        (np.pad(plane()[:4, :5], ((0, 36), (0, 59))), r"only 0\.78% of the depth image"),
    ],
)
def test_images_without_content_are_rejected(depth: NDArray[np.uint16], reason: str) -> None:
    with pytest.raises(BadFrameError, match=reason):
        combine([Exposure(depth, K, 0.0)] * 3, 0.0001)


@pytest.mark.parametrize("depth", [plane().astype(np.float32), plane().astype(np.uint8), np.stack([plane()] * 3, 2)])
def test_images_of_another_type_or_shape_are_rejected(depth: NDArray) -> None:
    with pytest.raises(BadFrameError, match=r"\(height, width\) and uint16 are needed"):
        combine([Exposure(depth, K, 0.0)], 0.0001)


def test_images_that_do_not_belong_together_are_rejected() -> None:
    first = Exposure(plane(), K, 0.0)
    for other in (Exposure(plane()[1:], K, 0.0), Exposure(plane(), K + np.diag([1.0, 1, 0]), 0.0)):
        with pytest.raises(BadFrameError, match="resolution or intrinsics changed"):
            combine([first, other], 0.0001)


def test_only_exposures_that_began_at_rest_count() -> None:
    after_s = time.monotonic() + 0.1
    exposures = wait_for_exposures(every(0.01, lambda now: now), after_s, 3, silence_s=5.0, patience_s=5.0)
    assert len(exposures) == 3
    assert all(exposure.began_s > after_s for exposure in exposures)


def test_an_exposure_that_ended_at_rest_but_began_before_does_not_count() -> None:
    after_s = time.monotonic()
    exposures = wait_for_exposures(every(0.01, lambda now: now - 0.1), after_s, 1, silence_s=5.0, patience_s=5.0)
    # It arrived at least 0.1 s after `after_s`, which is its latency.
    assert time.monotonic() - after_s >= 0.1
    assert exposures[0].began_s > after_s


def test_a_silent_camera_is_distinguished_from_a_slow_one() -> None:
    with pytest.raises(NoFramesError, match=r"no frame for 0\.1 s"):
        wait_for_exposures(every(60.0, lambda now: now), 0.0, 3, silence_s=0.1, patience_s=60.0)
    with pytest.raises(BadFrameError, match="only 1 of 3 frames began") as slow:
        wait_for_exposures(every(0.25, lambda now: now), time.monotonic(), 3, silence_s=60.0, patience_s=0.4)
    assert not isinstance(slow.value, NoFramesError)


def test_a_camera_with_a_wrong_clock_is_reported() -> None:
    with pytest.raises(BadFrameError, match=r"older ones came.*its clock is wrong"):
        wait_for_exposures(every(0.01, lambda now: now - 3600), time.monotonic(), 1, silence_s=5.0, patience_s=0.2)


def test_the_errors_can_be_sent_between_processes() -> None:
    error = pickle.loads(pickle.dumps(NoFramesError("silent")))
    assert isinstance(error, NoFramesError)
    assert str(error) == "silent"


def scene() -> NDArray[np.uint8]:
    return (np.indices((40, 64)).sum(axis=0) + 20).astype(np.uint8)


def frame_with(*pictures: Picture) -> NDArray[np.uint8]:
    image = combine([Exposure(plane(), K, 0.0)], 0.0001, pictures).image
    assert image is not None
    return image


def test_the_picture_of_a_frame_is_the_mean_of_its_pictures() -> None:
    assert combine([Exposure(plane(), K, 0.0)], 0.0001).image is None
    # Means of 20, 21 and 25 above the first: 22.
    image = frame_with(*(Picture(scene() + np.uint8(more), K, 0.0) for more in (20, 21, 25)))
    assert image.dtype == np.uint8
    assert np.array_equal(image, scene() + np.uint8(22))
    colours = np.dstack([scene(), scene() + np.uint8(10), scene() + np.uint8(20)])
    assert np.array_equal(frame_with(Picture(colours, K, 0.0)), colours)


def test_the_mean_of_several_pictures_has_less_noise() -> None:
    rng = np.random.default_rng(0)
    noisy = [np.rint(scene() + rng.normal(0, 2.0, (40, 64))).astype(np.uint8) for _ in range(5)]
    off = frame_with(*(Picture(pixels, K, 0.0) for pixels in noisy)).astype(float) - scene()
    # 2 grey levels by the root of five, plus rounding. 2560 pixels give 1.4 % of spread; three times is allowed.
    assert off.std() == pytest.approx(np.hypot(2.0 / np.sqrt(5), np.sqrt(1 / 12)), rel=0.05)


@pytest.mark.parametrize(
    ("pixels", "levels"),
    [
        (np.zeros((40, 64), np.uint8), "0 to 0"),
        (np.full((40, 64), 99, np.uint8), "99 to 99"),
        (np.full((40, 64), 255, np.uint8), "255 to 255"),
        # A covered lens shows noise only.
        (np.random.default_rng(0).normal(4, 1.5, (40, 64)).clip(0).astype(np.uint8), "0 to 7"),
        # A few bad pixels are not a picture either.
        (np.pad(np.full((1, 20), 255, np.uint8), ((0, 39), (0, 44))), "0 to 0"),
    ],
)
def test_pictures_without_content_are_rejected(pixels: NDArray[np.uint8], levels: str) -> None:
    for picture in (pixels, np.dstack([pixels] * 3)):
        with pytest.raises(BadFrameError, match=rf"shows nothing .grey levels {levels} of 255.*a lens is covered"):
            frame_with(Picture(picture, K, 0.0))


def test_a_picture_that_does_not_match_the_depth_image_is_rejected() -> None:
    # Single precision, as from depthai.
    assert np.array_equal(frame_with(Picture(scene(), K + 1e-5, 0.0)), scene())
    for pixels, matrix, expected in (
        (scene()[:, :60], K, "60x40, focal lengths 400.00, 400.00, centre 31.50, 19.50"),
        (scene(), K + np.diag([1.0, 0, 0]), "64x40, focal lengths 401.00, 400.00"),
        (scene(), K + [[0, 0, 0], [0, 0, 0.5], [0, 0, 0]], "centre 31.50, 20.00"),
    ):
        with pytest.raises(
            BadFrameError, match=f"picture .*{expected}.*does not fit its depth image .64x40, .*check its"
        ):
            frame_with(Picture(pixels, matrix, 0.0))
    with pytest.raises(BadFrameError, match="picture's resolution or intrinsics changed"):
        frame_with(Picture(scene(), K, 0.0), Picture(scene()[1:], K, 0.0))


def test_the_intensity_image_is_the_mean_of_the_left_images() -> None:
    exposure = Exposure(plane(), K, 0.0)
    assert combine([exposure], 0.0001).intensity is None
    left_images = [Picture(scene() + np.uint8(more), K + 1e-5, 0.0) for more in (20, 21, 25)]
    frame = combine([exposure], 0.0001, left_images=left_images)
    assert frame.image is None
    assert frame.intensity is not None
    assert frame.intensity.dtype == np.uint8
    assert np.array_equal(frame.intensity, scene() + np.uint8(22))
    # A dark image is no error of a scan: recognition does not depend on it.
    dark = combine([exposure], 0.0001, left_images=[Picture(np.zeros((40, 64), np.uint8), K, 0.0)])
    assert dark.intensity is not None
    assert not dark.intensity.any()


@pytest.mark.parametrize(
    ("pixels", "matrix"),
    [(scene()[:, :60], K), (scene(), K + np.diag([1.0, 0, 0])), (np.dstack([scene()] * 3), K)],
)
def test_left_images_that_do_not_match_the_depth_image_are_left_out(
    pixels: NDArray[np.uint8], matrix: NDArray[np.float64], caplog: pytest.LogCaptureFixture
) -> None:
    left_images = [Picture(scene(), K, 0.0), Picture(pixels, matrix, 0.0)]
    frame = combine([Exposure(plane(), K, 0.0)] * 2, 0.0001, left_images=left_images)
    assert frame.intensity is None
    (message,) = caplog.messages
    assert "no intensity image: the camera's image" in message
    assert "does not fit its depth image (64x40" in message


def test_a_camera_that_sends_no_pictures_is_reported() -> None:
    def receive(wait_s: float) -> Picture | None:
        time.sleep(wait_s)
        return None

    with pytest.raises(NoFramesError, match=r"no picture for 0\.1 s"):
        wait_for_exposures(receive, 0.0, 3, silence_s=0.1, patience_s=60.0, what="picture")
