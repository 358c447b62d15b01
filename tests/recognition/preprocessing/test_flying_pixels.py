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
