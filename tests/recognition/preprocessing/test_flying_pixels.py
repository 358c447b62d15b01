"""Filter of flying pixels: straight edges stay."""

from dataclasses import dataclass

import numpy as np
import pytest

from recognition.parameters import ChainParameters
from recognition.preprocessing.flying_pixels import is_on_surface


@dataclass(frozen=True)
class Image:
    depth: np.ndarray
    depth_unit_m: float
    K: np.ndarray


def image(depth: np.ndarray, focal_px: float = 440.0) -> Image:
    return Image(depth.astype(np.uint16), 1e-4, np.diag([focal_px, focal_px, 1.0]))


def kept(depth_image: Image, parameters: ChainParameters) -> np.ndarray:
    """Return the mask (H, W) of the pixels that stay."""
    rows, columns = np.indices(depth_image.depth.shape).reshape(2, -1)
    return is_on_surface(depth_image, rows, columns, parameters).reshape(depth_image.depth.shape)


def test_a_straight_edge_stays_and_flying_pixels_go(table_1: ChainParameters) -> None:
    depth = np.full((30, 40), 4400)
    depth[:, 20:] = 4200  # 20 mm nearer
    depth[10, 20] = 4300  # halfway between
    depth[20, 10] = 4250  # above the table
    depth[25, 30] = 0  # a hole
    result = kept(image(depth), table_1)
    gone = np.argwhere(~result[1:-1, 1:-1]) + 1
    # The flying pixels, the hole, and of the edge only the two pixels beside the flying one.
    assert {(10, 20), (20, 10), (25, 30)} <= {tuple(pixel) for pixel in gone}
    assert {tuple(pixel) for pixel in gone} - {(10, 20), (20, 10), (25, 30)} <= {(9, 20), (11, 20)}


def test_the_slope_of_a_string_stays(table_1: ChainParameters) -> None:
    # A string along the image's columns, seen from 0.4 m: 9 pixels wide.
    across = (np.arange(40) - 20) * 0.4 / 440.0
    height = np.sqrt(np.maximum(table_1.r**2 - across**2, 0.0))
    depth = np.tile(np.rint((0.4 - height) / 1e-4), (30, 1))
    result = kept(image(depth), table_1)
    assert result[1:-1, 17:24].all()


@pytest.mark.parametrize(("focal_px", "stays"), [(440.0, False), (90.0, True)])
def test_a_string_two_pixels_wide_stays(table_1: ChainParameters, focal_px: float, stays: bool) -> None:
    depth = np.full((30, 40), 4400)
    depth[:, 20] = 4200
    # A column one pixel wide is a spike if strings are nine pixels wide, and a string if strings are two pixels wide.
    assert kept(image(depth, focal_px), table_1)[5:25, 20].all() == stays


def test_the_image_ends_at_its_border(table_1: ChainParameters) -> None:
    result = kept(image(np.full((6, 8), 4400)), table_1)
    # Five neighbours at the border, three in the corners; none from the other side.
    assert np.argwhere(~result).tolist() == [[0, 0], [0, 7], [5, 0], [5, 7]]


@pytest.mark.parametrize("lost_share", [0.3, 0.6])
def test_scattered_losses_inside_a_surface_count_as_measured(table_1: ChainParameters, lost_share: float) -> None:
    rng = np.random.default_rng(1)
    depth = np.full((60, 80), 4200)
    depth[rng.random(depth.shape) < lost_share] = 0
    result = kept(image(depth), table_1)[2:-2, 2:-2]
    assert result[depth[2:-2, 2:-2] > 0].mean() > 0.7
    # A flying pixel goes, although neighbours are lost.
    depth[::7, ::7] = 4100
    assert not kept(image(depth), table_1)[2:-2, 2:-2][depth[2:-2, 2:-2] == 4100].any()


@pytest.mark.parametrize("shadow_px", [1, 2, 5])
def test_the_shadow_of_an_edge_is_no_scattered_loss(table_1: ChainParameters, shadow_px: int) -> None:
    """A spike of an edge goes, whether the pixels beside it are measured or lie in a shadow."""
    depth = np.full((40, 80), 4400)
    depth[:, :40] = 4200
    depth[10::8, 40] = 4200
    shadow = depth.copy()
    for v in range(len(depth)):
        edge = 41 if depth[v, 40] == 4200 else 40
        shadow[v, edge : edge + shadow_px] = 0
    measured, shaded = kept(image(depth), table_1), kept(image(shadow), table_1)
    assert not measured[10::8, 40].any()
    np.testing.assert_array_equal(shaded[:, :41] & (depth[:, :41] == 4200), measured[:, :41] & (depth[:, :41] == 4200))


def test_a_rare_loss_is_not_counted(table_1: ChainParameters) -> None:
    depth = np.full((60, 80), 4200)
    depth[29:32, 39:42] = 0
    depth[30, 40] = depth[29, 39] = depth[31, 41] = depth[29, 41] = depth[31, 39] = 4200  # four of eight neighbours
    assert not kept(image(depth), table_1)[30, 40]
