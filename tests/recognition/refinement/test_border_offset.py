"""Border offset of strings in exact depth images of strings that are thicker or thinner than their tubes."""

import numpy as np
import pytest

from cell.planning.look_at import look_at
from cell.simulation.rendering.depth_camera import DepthCamera, camera_model
from cell.simulation.scenes.scenes import StringScene
from recognition.preprocessing.normals import NormalCloud
from recognition.refinement.border_offset import MAX_OFFSET_RADII, measure_border_offset
from tests.recognition.captured_strings import Image

R = 0.0042
RADII = np.array([R])
TABLE_Z = 0.0


def line(y: float = 0.0) -> np.ndarray:
    """Return the centre line (N, 3) of a resting string of radius R along x."""
    x = np.arange(-0.1, 0.1, 0.7 * R)
    return np.column_stack([x, np.full(len(x), y), np.full(len(x), R)])


def views_of(radius_m: float, elevation_deg: float = 60.0) -> list[NormalCloud]:
    """Capture four views of a string along x whose centre line is that of a resting string of radius R."""
    x = np.arange(-0.12, 0.1201, 0.001)
    curve = np.column_stack([x, np.zeros(len(x)), np.full(len(x), R)])
    camera = DepthCamera(camera_model("exact"), StringScene("straight", radius_m, (curve,)))
    clouds = []
    for k in range(4):
        T = look_at(np.zeros(3), np.radians(20 + 90 * k), np.radians(elevation_deg), 0.4, 0.0)
        depth = camera.capture(T, np.random.default_rng(k))
        image = Image(depth, camera.model.depth_unit_m, camera.model.K, T, k)
        clouds.append(NormalCloud(k, np.empty((0, 3)), np.empty((0, 3)), np.eye(4), T, image))
    return clouds


@pytest.mark.parametrize("elevation_deg", [40.0, 60.0, 85.0])
@pytest.mark.parametrize("excess", [-0.2, -0.1, 0.0, 0.1, 0.2])
def test_the_offset_is_that_of_the_sides(excess: float, elevation_deg: float) -> None:
    offset = measure_border_offset([line()], RADII, views_of((1 + excess) * R, elevation_deg), TABLE_Z, R)
    # A sample is 0.08 r wide, and a pixel 1.0 mm or 0.24 r; their phases differ along the string.
    assert offset == pytest.approx(excess * R, abs=0.06 * R)


def test_the_offset_is_limited() -> None:
    assert measure_border_offset([line()], RADII, views_of(2 * R), TABLE_Z, R) == MAX_OFFSET_RADII * R


@pytest.mark.parametrize(
    "lines",
    [
        # Ends take more than half of a short line, and the others rest nowhere or lie beside each other.
        [line()[:12]],
        [line() + (0.0, 0.0, 2 * R)],
        [line(), line(3 * R)],
    ],
    ids=["short", "lifted", "side-by-side"],
)
def test_too_few_resting_positions_show_no_offset(lines: list[np.ndarray]) -> None:
    radii = np.full(len(lines), R)
    assert measure_border_offset(lines, radii, views_of(1.2 * R), TABLE_Z, R) == 0.0


def test_without_images_there_is_no_offset() -> None:
    assert measure_border_offset([line()], RADII, [], TABLE_Z, R) == 0.0
    (cloud, *_) = views_of(R)
    no_image = NormalCloud(0, cloud.points, cloud.normals, cloud.T_correction, cloud.T_base_camera)
    assert measure_border_offset([line()], RADII, [no_image], TABLE_Z, R) == 0.0
