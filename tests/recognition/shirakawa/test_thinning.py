"""Thinning, eq. (3)."""

import numpy as np

from recognition.parameters import ChainParameters
from recognition.shirakawa.thinning import thin


def test_eq_3_by_a_loop(table_1: ChainParameters) -> None:
    points = np.random.default_rng(3).uniform(0, 0.02, (120, 3))
    thinned = thin(points, table_1)
    for p, a in zip(points, thinned, strict=True):
        q = [other for other in points if np.linalg.norm(other - p) <= table_1.r_c]
        np.testing.assert_allclose(a, sum(q) / len(q), rtol=0, atol=1e-16)


def test_a_band_becomes_narrower_and_keeps_its_line(table_1: ChainParameters) -> None:
    rng = np.random.default_rng(4)
    x = np.linspace(0, 0.1, 3000)
    band = np.column_stack([x, rng.uniform(-0.001, 0.001, 3000), np.full(3000, 0.0042)])
    thinned = thin(band, table_1)
    # Some 250 neighbours of 0.58 mm spread: their mean scatters by 0.04 mm. Five of that.
    assert np.abs(thinned[:, 1]).max() < 0.0002
    assert np.abs(thinned[:, 2] - 0.0042).max() < 1e-12


def test_a_point_alone_stays(table_1: ChainParameters) -> None:
    np.testing.assert_array_equal(thin(np.array([[0.1, 0.2, 0.3]]), table_1), [[0.1, 0.2, 0.3]])
    assert thin(np.empty((0, 3)), table_1).shape == (0, 3)
