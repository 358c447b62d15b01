"""Strings and parameters that the tests of several stages share."""

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from recognition.parameters import ChainParameters

Points = NDArray[np.float64]


@pytest.fixture(scope="session")
def table_1() -> ChainParameters:
    """The paper's parameters: r = 4.2 mm."""
    return ChainParameters.for_radius(0.0042)


@pytest.fixture(scope="session")
def round_figures() -> ChainParameters:
    """r = 10 mm: r_n = 10, r_f = 20, r_cn = 30, r_cf = 35 mm, so that hand-made points are easy to read."""
    return ChainParameters.for_radius(0.01)


@pytest.fixture(scope="session")
def tube() -> Callable[..., tuple[Points, Points]]:
    """`tube(curve, r, low, high, around)`: points and exact outward normals of the tube of radius r about a curve.

    Both (N * around, 3). Only the part between the angles `low` and `high` is made, 0 being to the curve's left
    and pi/2 on top, as a camera sees one side only.
    """

    def make(
        curve: Points, r: float, low: float = 0.0, high: float = 2 * np.pi, around: int = 24
    ) -> tuple[Points, Points]:
        tangent = np.gradient(curve, axis=0)
        tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
        left = np.cross((0.0, 0.0, 1.0), tangent)
        left /= np.linalg.norm(left, axis=1, keepdims=True)
        up = np.cross(tangent, left)
        whole = np.isclose(high - low, 2 * np.pi)
        angles = np.linspace(low, high, around, endpoint=not whole)[:, None]
        normals = np.cos(angles) * left[:, None] + np.sin(angles) * up[:, None]
        return (curve[:, None] + r * normals).reshape(-1, 3), normals.reshape(-1, 3)

    return make
