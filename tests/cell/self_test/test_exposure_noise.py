"""Noise of exposures: synthetic stacks with known noise, and the result of the self-test for it."""

import numpy as np
import pytest
from numpy.typing import NDArray

from cell.config.camera_config import SimulatedCamera
from cell.self_test.exposure_check import noise_found
from cell.self_test.exposure_noise import ExposureNoise, MedianNoise, measure_noise, recommended_exposures

UNIT_M = 1e-5
"""Depth unit of the stacks. Its rounding is small against all noise."""
SIZE = 100, 160
COUNT = 25
STRINGS = slice(45, 53)
"""Rows of two strings, 8 mm above the table."""


def exact_depth_m() -> NDArray[np.float64]:
    """Return the depth (H, W) of a tilted table. Its inverse is linear in the pixels."""
    v, u = np.indices(SIZE)
    depth = 1 / (2.2 - 0.001 * u + 0.002 * v)
    depth[STRINGS, 10:70] -= 0.008
    depth[STRINGS, 90:150] -= 0.008
    return depth


def exposures(fixed_m: float, temporal_m: float, seed: int = 0) -> NDArray[np.float64]:
    rng = np.random.default_rng(seed)
    still = exact_depth_m() + fixed_m * rng.standard_normal(SIZE)
    return still + temporal_m * rng.standard_normal((COUNT, *SIZE))


def measured(depth_m: NDArray[np.float64]) -> ExposureNoise:
    noise = measure_noise(np.rint(depth_m / UNIT_M).astype(np.uint16), UNIT_M)
    assert noise is not None
    return noise


@pytest.mark.parametrize(("fixed_m", "temporal_m"), [(0.001, 0.0006), (0.0003, 0.0009), (0.0008, 0.0)])
def test_fixed_and_temporal_noise_are_separated(fixed_m: float, temporal_m: float) -> None:
    noise = measured(exposures(fixed_m, temporal_m))
    # Pixels beyond 3 sigma count as objects, which lowers the standard deviation by 1.4 %. 13000 pixels vary by 0.6 %.
    assert noise.fixed_m == pytest.approx(fixed_m, rel=0.03)
    # Standard deviations of the median of 1, 3 and 5 normal samples. 13000 pixels with at least 5 views vary by 0.3 %.
    for median, factor in zip(noise.medians, (1.0, 0.6698, 0.5355), strict=True):
        assert median.temporal_m == pytest.approx(factor * temporal_m, rel=0.02, abs=1e-6)
        assert median.total_m == pytest.approx(np.hypot(noise.fixed_m, median.temporal_m))
    # The strings have 2 * 8 * 60 pixels. The pixels within 4 pixels of them are edge pixels too.
    assert noise.edge_pixels == pytest.approx(2 * (8 + 8) * (60 + 8), rel=0.05)


@pytest.mark.parametrize("lost", [True, False])
def test_flicker_at_edges_is_the_share_of_pixels_that_change(lost: bool) -> None:
    """A tenth of the depths near the strings is missing, or is that of a surface 8 mm nearer."""
    depth_m = exposures(0.0, 0.0)
    near = np.zeros(SIZE, dtype=bool)
    near[STRINGS.start - 8 : STRINGS.stop + 8] = True
    wrong = near & (np.random.default_rng(1).random(depth_m.shape) < 0.1)
    noise = measured(np.where(wrong, 0.0 if lost else depth_m - 0.008, depth_m))
    # A view is wrong if most of its exposures are: 0.1, 0.028, 0.00856. Two views differ if one of them is wrong.
    for median, share in zip(noise.medians, (0.1, 0.028, 0.00856), strict=True):
        # 2200 pixels in at least 4 pairs of views: 0.003 or less
        assert median.flicker_share == pytest.approx(2 * share * (1 - share), abs=0.01)
    assert recommended_exposures(noise) == 5


def test_a_table_without_objects_gives_no_recommendation() -> None:
    v, u = np.indices(SIZE)
    depth_m = 1 / (2.2 - 0.001 * u + 0.002 * v) + 0.001 * np.random.default_rng(0).standard_normal((COUNT, *SIZE))
    noise = measured(depth_m)
    assert noise.edge_pixels == 0
    assert [median.flicker_share for median in noise.medians] == [None] * 3
    assert recommended_exposures(noise) is None
    step = noise_found(noise, 30.0, SimulatedCamera())
    assert step.outcome == "ok"
    assert "lay a string on the table" in step.message


@pytest.mark.parametrize("filled", [0.0, 0.1])
def test_an_image_without_a_table_has_no_noise(filled: float) -> None:
    depth = np.zeros((COUNT, *SIZE), dtype=np.uint16)
    depth[:, : round(filled * SIZE[0])] = 5000
    assert measure_noise(depth, 1e-4) is None
    scattered = np.random.default_rng(0).uniform(0.2, 3.0, SIZE)
    assert measure_noise(np.broadcast_to(np.rint(scattered / 1e-4).astype(np.uint16), (COUNT, *SIZE)), 1e-4) is None


def noise_of(total_m: tuple[float, ...], flicker: tuple[float, ...]) -> ExposureNoise:
    medians = (MedianNoise(n, 0.0, total, share) for n, total, share in zip((1, 3, 5), total_m, flicker, strict=True))
    return ExposureNoise(0.001, 10_000, 1000, tuple(medians))


@pytest.mark.parametrize(
    ("total_mm", "flicker", "expected"),
    [
        ((1.04, 1.02, 1.0), (0.02, 0.02, 0.02), 1),
        ((1.06, 1.02, 1.0), (0.02, 0.02, 0.02), 3),
        ((1.20, 1.06, 1.0), (0.02, 0.02, 0.02), 5),
        ((1.04, 1.02, 1.0), (0.05, 0.02, 0.02), 3),
        ((1.04, 1.02, 1.0), (0.09, 0.05, 0.02), 5),
        ((1.04, 1.02, 1.0), (0.01, 0.02, 0.05), 1),
    ],
)
def test_the_smallest_number_that_is_as_good_as_five_is_recommended(
    total_mm: tuple[float, ...], flicker: tuple[float, ...], expected: int
) -> None:
    noise = noise_of(tuple(value / 1000 for value in total_mm), flicker)
    assert recommended_exposures(noise) == expected


def test_the_self_test_compares_the_recommendation_with_the_configuration() -> None:
    noise = noise_of((0.0012, 0.00102, 0.001), (0.05, 0.02, 0.02))
    more, same, fewer = (noise_found(noise, 30.1, SimulatedCamera(exposures=count)) for count in (5, 3, 1))
    assert (more.outcome, same.outcome, fewer.outcome) == ("ok", "ok", "warning")
    assert more.message.splitlines()[-1] == "3 would do, 5 are configured: 3 would save 0.07 s a view"
    assert same.message.splitlines()[-1] == "3 recommended, 3 configured"
    assert fewer.what_to_do == "set it to 3"
    assert more.figures is not None
    assert more.figures["recommended_exposures"] == 3
    assert [median["time_s"] for median in more.figures["medians"]] == pytest.approx([1 / 30, 3 / 30, 5 / 30])


@pytest.mark.parametrize("noise", [None, noise_of((0.001,) * 3, (0.0,) * 3)])
def test_a_frame_rate_that_is_not_reached_is_reported(noise: ExposureNoise | None) -> None:
    settings = SimulatedCamera(model="ideal", exposures=1)
    assert noise_found(noise, 27.1, settings).outcome == "ok"
    step = noise_found(noise, 13.8, settings)
    assert step.outcome == "warning"
    assert "the camera sends 13.8 instead of 30 images/s" in step.message
    rendering = noise_found(noise, 13.8, SimulatedCamera(exposures=1))
    assert rendering.outcome == "ok", "the computer sets the rate of a camera that renders its images"
    assert rendering.message.startswith("13.8 images/s, as this computer renders them")
    assert noise is None or step.figures is None or step.figures["medians"][2]["time_s"] == pytest.approx(5 / 13.8)
    assert "set camera.fps to 14" in (step.what_to_do or "")
    assert step.figures is not None
    assert (step.figures["frame_rate"], step.figures["configured_frame_rate"]) == (13.8, 30.0)


def test_a_simulated_camera_may_render_its_images_slowly() -> None:
    step = noise_found(None, 6.0, SimulatedCamera(model="oak-d-pro"))
    assert step.outcome == "ok"
    assert "6.0 images/s, as this computer renders them" in step.message
