"""The scatter of the depth, measured on the table."""

import numpy as np
import pytest

from recognition.parameters import ChainParameters
from recognition.preprocessing.table_scatter import table_scatter


def table(noise_m: float, warp_m: float = 0.0, seed: int = 0) -> np.ndarray:
    """Return points of a table of 0.4 m with independent noise, and a wave of 0.2 m."""
    rng = np.random.default_rng(seed)
    xy = rng.uniform(-0.2, 0.2, (10_000, 2))
    z = rng.normal(0, noise_m, len(xy)) + warp_m * np.sqrt(2) * np.sin(2 * np.pi * xy[:, 0] / 0.2)
    return np.column_stack([xy, z])


def test_independent_noise_is_in_pixels_and_not_in_patches(table_1: ChainParameters) -> None:
    scatter = table_scatter(table(0.001), 0.0, table_1, True)
    assert scatter.pixel_m == pytest.approx(0.001, rel=0.1)
    assert scatter.patch_m < 0.0003


def test_a_slow_warp_is_in_patches(table_1: ChainParameters) -> None:
    scatter = table_scatter(table(0.0003, 0.001), 0.0, table_1, True)
    assert 0.0006 < scatter.patch_m < 0.0014


@pytest.mark.parametrize("share", [0.1, 0.5])
def test_a_flat_object_is_no_noise(table_1: ChainParameters, share: float) -> None:
    points = table(0.0003)
    points[points[:, 1] > 0.2 - 0.4 * share, 2] += 0.003
    scatter = table_scatter(points, 0.0, table_1, True)
    assert scatter.pixel_m < 0.001
    assert scatter.patch_m < 0.0005


def test_a_tilted_view_has_the_scatter_of_a_plane_of_its_own(table_1: ChainParameters) -> None:
    points = table(0.0005)
    points[:, 2] += 0.03 * points[:, 0]
    assert table_scatter(points, 0.0, table_1, False).pixel_m == pytest.approx(0.0005, rel=0.1)


def test_without_a_table_the_scatter_is_unknown(table_1: ChainParameters) -> None:
    scatter = table_scatter(table(0.001) + (0, 0, 0.1), 0.0, table_1, True)
    assert (scatter.pixel_m, scatter.patch_m) == (0.0, 0.0)
