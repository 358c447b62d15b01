import numpy as np
import pytest

from cell.config.rendering_options import SHEATHS, TABLE_TOPS, RenderingOptions, Sheath, TableTop
from cell.simulation.rendering.appearance import (
    STRING_REFLECTANCE,
    TABLE_REFLECTANCE,
    TEXTURED_SHEATHS,
    TEXTURED_TABLE_TOPS,
    TILE,
    Appearance,
    Texture,
    appearance_of_seed,
    sample_image,
    sheath_texture,
    table_texture,
)

CONTRASTS = {"speckled": 0.35, "painted": 0.30, "woven": 0.25, "smooth": 0.02}


def test_an_appearance_is_drawn_among_materials_with_texture() -> None:
    drawn = [appearance_of_seed(RenderingOptions(), seed) for seed in range(60)]
    assert {appearance.sheath for appearance in drawn} == set(TEXTURED_SHEATHS)
    assert {appearance.table_top for appearance in drawn} == set(TEXTURED_TABLE_TOPS)
    for appearance in drawn:
        assert STRING_REFLECTANCE[0] <= appearance.string_reflectance <= STRING_REFLECTANCE[1]
        assert TABLE_REFLECTANCE[0] <= appearance.table_reflectance <= TABLE_REFLECTANCE[1]


def test_configured_materials_do_not_change_the_reflectances() -> None:
    drawn = appearance_of_seed(RenderingOptions(), 5)
    given = appearance_of_seed(RenderingOptions("smooth", "bare"), 5)
    assert (given.sheath, given.table_top) == ("smooth", "bare")
    assert given.string_reflectance == drawn.string_reflectance
    assert given.table_reflectance == drawn.table_reflectance


@pytest.mark.parametrize("sheath", SHEATHS)
def test_a_sheath_has_the_stated_mean_and_contrast(sheath: Sheath) -> None:
    texture = sheath_texture(Appearance(sheath, "bare", 0.4, 0.4), np.random.default_rng(1))
    # A tile of 1024 texels holds few of the largest spots, so the mean is off by some percent of the contrast.
    assert texture.tile.mean() == pytest.approx(0.4, rel=0.05)
    # Dark spots are cut off at a small reflectance, which takes at most a few percent of the contrast.
    assert texture.tile.std() / 0.4 == pytest.approx(CONTRASTS[sheath], rel=0.1)
    assert texture.tile.min() > 0
    assert texture.tile.max() <= 1


@pytest.mark.parametrize("table_top", TABLE_TOPS)
def test_textures_repeat_without_a_seam(table_top: TableTop) -> None:
    tile = table_texture(Appearance("smooth", table_top, 0.4, 0.4), np.random.default_rng(1)).tile
    inside = np.abs(np.diff(tile, axis=1)).mean()
    seam = np.abs(tile[:, 0] - tile[:, -1]).mean()
    # The mean over 1024 rows, which are correlated, is off by some percent.
    assert seam == pytest.approx(inside, rel=0.2)


def test_a_texture_is_interpolated_and_repeats() -> None:
    tile = np.zeros((TILE, TILE), dtype=np.float32)
    tile[:, 1] = 1.0
    texture = Texture(tile, 0.001)
    x = np.array([0.0, 0.0005, 0.001, 0.00125, 0.001 + TILE * 0.001], dtype=np.float32)
    # OpenCV interpolates in steps of 1/32 texel; float32 leaves 1e-7 of a coordinate of about 1 m.
    assert texture.at(x, np.zeros_like(x)) == pytest.approx([0, 0.5, 1, 0.75, 1], abs=0.01)


def test_many_points_are_sampled_and_the_outside_is_dark() -> None:
    image = np.arange(12, dtype=np.float32).reshape(3, 4)
    count = 1500
    column = np.tile(np.array([0, 3, 9], dtype=np.float32), count)
    row = np.tile(np.array([0, 2, 1], dtype=np.float32), count)
    assert np.array_equal(sample_image(image, column, row, wrap=False), np.tile([0, 11, 0], count))


def test_no_points_have_no_values() -> None:
    nothing = np.zeros(0, dtype=np.float32)
    assert sample_image(np.ones((2, 2), dtype=np.float32), nothing, nothing, wrap=True).shape == (0,)
