import numpy as np
import pytest
from numpy.typing import NDArray

from cell.planning.look_at import look_at
from cell.simulation.rendering.appearance import Appearance
from cell.simulation.rendering.image_renderer import (
    BLACK,
    DARK_NOISE,
    SHOT_NOISE,
    WHITE,
    ImageRenderer,
    PixelShift,
    Scenery,
    develop,
)
from cell.simulation.rendering.lighting import Lamp
from cell.simulation.rendering.materials import Materials
from cell.simulation.rendering.ray_caster import RayCaster
from cell.simulation.scenes.scenes import StringScene, make_scene

WIDTH, HEIGHT = 160, 100
K = np.array([[110.0, 0, (WIDTH - 1) / 2], [0, 110.0, (HEIGHT - 1) / 2], [0, 0, 1]])
POSE = look_at(np.zeros(3), 0.4, np.deg2rad(75), 0.4, 0.1)
LAMP = Lamp(np.array([0.0, 0.4, 1.2]))


def renderer(scene: StringScene, appearance: Appearance) -> ImageRenderer:
    caster = RayCaster(scene)
    scenery = Scenery(caster, Materials(scene, appearance, seed=1), LAMP, strings=len(scene.curves))
    return ImageRenderer(scenery, K, WIDTH, HEIGHT)


@pytest.fixture(scope="module")
def printed() -> ImageRenderer:
    return renderer(make_scene("loop", 1), Appearance("speckled", "printed", 0.6, 0.4))


def test_a_bright_string_lies_on_a_darker_table() -> None:
    scene = make_scene("straight", 0)
    image = renderer(scene, Appearance("smooth", "bare", 0.7, 0.3)).render(POSE)
    K_inverse = np.linalg.inv(K)
    v, u = np.mgrid[:HEIGHT, :WIDTH]
    rays = np.stack([u, v, np.ones_like(u)], axis=-1) @ K_inverse.T @ POSE[:3, :3].T
    hits = RayCaster(scene).cast(POSE[:3, 3], rays.reshape(-1, 3).astype(np.float32))
    on_string = (hits.part == 0).reshape(HEIGHT, WIDTH)
    assert on_string.sum() > 100
    table = np.median(image[~on_string])
    # The table has the reflectance 0.3 in light of about 1, less a few percent of vignetting and distance.
    assert table == pytest.approx(BLACK + (WHITE - BLACK) * 0.3, rel=0.12)
    assert np.median(image[on_string]) > 1.5 * table


def test_a_pixel_shift_moves_the_image_by_that_much(printed: ImageRenderer) -> None:
    shape = (HEIGHT, WIDTH)
    whole = printed.render(POSE)
    moved = printed.render(
        POSE, PixelShift(np.full(shape, 3.0, dtype=np.float32), np.full(shape, -2, dtype=np.float32))
    )
    inner = (slice(10, HEIGHT - 10), slice(10, WIDTH - 10))
    expected = np.roll(whole, (-2, 3), axis=(0, 1))
    # Vignetting moves with the lens, not with the image: by 3 pixels it changes by at most 2 %.
    assert moved[inner] == pytest.approx(expected[inner], rel=0.03, abs=1.0)


@pytest.mark.parametrize("shift_px", [0.3, -0.5])
def test_a_part_of_a_pixel_is_measured_by_correlation(printed: ImageRenderer, shift_px: float) -> None:
    import cv2

    shape = (HEIGHT, WIDTH)
    shift = PixelShift(np.full(shape, shift_px, dtype=np.float32), np.zeros(shape, dtype=np.float32))
    (column, row), _ = cv2.phaseCorrelate(
        printed.render(POSE).astype(np.float64), printed.render(POSE, shift).astype(np.float64)
    )
    # Phase correlation itself is good to about a tenth of a pixel.
    assert column == pytest.approx(shift_px, abs=0.12)
    assert row == pytest.approx(0, abs=0.05)


def test_an_image_does_not_depend_on_the_bands(printed: ImageRenderer, monkeypatch: pytest.MonkeyPatch) -> None:
    image = printed.render(POSE)
    monkeypatch.setattr("cell.simulation.rendering.image_renderer._BAND", 7)
    # The directions are products of matrices, whose last digit depends on their size.
    assert printed.render(POSE) == pytest.approx(image, abs=0.05)


def test_without_a_surface_the_image_is_dark(printed: ImageRenderer) -> None:
    up = look_at(np.array([0.0, 0.0, 1.0]), 0.0, -1.2, 0.6, 0.0)
    assert printed.render(up).max() < 20


def grey(level: float) -> NDArray[np.float32]:
    return np.full((200, 200), level, dtype=np.float32)


@pytest.mark.parametrize("level", [BLACK, 60.0, 200.0])
def test_developing_adds_dark_noise_and_shot_noise(level: float) -> None:
    image = develop(grey(level), np.random.default_rng(0)).astype(np.float64)
    expected = np.sqrt(DARK_NOISE**2 + SHOT_NOISE**2 * level / 255 + 1 / 12)
    # The standard deviation of 40,000 samples is off by 0.4 %.
    assert image.std() == pytest.approx(expected, rel=0.02)
    assert image.mean() == pytest.approx(level, abs=0.05)


def test_developed_images_do_not_leave_the_grey_levels() -> None:
    bright = develop(grey(400.0), np.random.default_rng(0))
    assert bright.dtype == np.uint8
    assert bright.min() == 255
