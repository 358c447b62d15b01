"""The scatter of the depth, measured on the table."""

import numpy as np
import pytest

from recognition.parameters import ChainParameters
from recognition.preprocessing.table_scatter import patch_pixels, table_scatter


def table(noise_m: float, warp_m: float = 0.0, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Return points and patches of a table of 0.4 m with independent noise, and a wave of 0.2 m."""
    rng = np.random.default_rng(seed)
    xy = rng.uniform(-0.2, 0.2, (10_000, 2))
    patch_xy = rng.uniform(-0.2, 0.2, (600, 1, 2)) + rng.uniform(-0.004, 0.004, (600, 16, 2))

    def measured(xy: np.ndarray) -> np.ndarray:
        z = rng.normal(0, noise_m, xy.shape[:-1]) + warp_m * np.sqrt(2) * np.sin(2 * np.pi * xy[..., 0] / 0.2)
        return np.concatenate([xy, z[..., None]], axis=-1)

    return measured(xy), measured(patch_xy)


def test_independent_noise_is_in_pixels_and_not_in_patches(table_1: ChainParameters) -> None:
    scatter = table_scatter(*table(0.001), 0.0, table_1, True)
    assert scatter.pixel_m == pytest.approx(0.001, rel=0.1)
    assert scatter.patch_m is not None
    assert scatter.patch_m < 0.00015


def test_a_slow_warp_is_in_patches(table_1: ChainParameters) -> None:
    scatter = table_scatter(*table(0.0003, 0.001), 0.0, table_1, True)
    assert scatter.patch_m is not None
    assert 0.0006 < scatter.patch_m < 0.0014


def test_noise_that_a_patch_shares_is_in_patches(table_1: ChainParameters) -> None:
    points, patches = table(0.0003)
    patches[..., 2] += np.random.default_rng(1).normal(0, 0.0002, (600, 1))
    assert table_scatter(points, patches, 0.0, table_1, True).patch_m == pytest.approx(0.0002, rel=0.15)
    # Patches with holes count, unless too few of their pixels are left.
    patches[:, :4] = np.nan
    assert table_scatter(points, patches, 0.0, table_1, True).patch_m == pytest.approx(0.0002, rel=0.15)
    patches[:, 4] = np.nan
    assert table_scatter(points, patches, 0.0, table_1, True).patch_m is None


@pytest.mark.parametrize("shape", [(400, 640), (12, 9), (2, 3)])
@pytest.mark.parametrize("edge_px", [0.0, 3.4, 8.0, 2000.0])
def test_patches_have_different_pixels_in_the_image(shape: tuple[int, int], edge_px: float) -> None:
    rows, columns = patch_pixels(shape, edge_px)
    edge = min(max(round(edge_px), 2), *shape)
    for pixels, size in zip((rows, columns), shape, strict=True):
        assert pixels.min() >= 0
        assert pixels.max() < size
        assert (np.ptp(pixels, axis=1) < edge).all()
    for row, column in zip(rows, columns, strict=True):
        assert len(set(zip(row, column, strict=True))) == min(edge**2, 16)


@pytest.mark.parametrize("share", [0.1, 0.5])
def test_a_flat_object_is_no_noise(table_1: ChainParameters, share: float) -> None:
    points, patches = table(0.0003)
    for surface in (points, patches):
        surface[surface[..., 1] > 0.2 - 0.4 * share, 2] += 0.003
    scatter = table_scatter(points, patches, 0.0, table_1, True)
    assert scatter.pixel_m < 0.001
    assert scatter.patch_m is not None
    assert scatter.patch_m < 0.0005


def test_a_tilted_view_has_the_scatter_of_a_plane_of_its_own(table_1: ChainParameters) -> None:
    points, patches = table(0.0005)
    for surface in (points, patches):
        surface[..., 2] += 0.03 * surface[..., 0]
    scatter = table_scatter(points, patches, 0.0, table_1, False)
    assert scatter.pixel_m == pytest.approx(0.0005, rel=0.1)
    assert scatter.patch_m is not None
    assert scatter.patch_m < 0.0001


def test_without_a_table_the_scatter_is_unknown(table_1: ChainParameters) -> None:
    points, patches = table(0.001)
    scatter = table_scatter(points + (0, 0, 0.1), patches + (0, 0, 0.1), 0.0, table_1, True)
    assert (scatter.pixel_m, scatter.patch_m) == (0.0, None)
