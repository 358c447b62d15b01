"""Smooth axes through the middle pixels of bands in an image."""

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

SPAN_MARGIN = 1.05
"""Distance at which the weight of a middle pixel would be zero, in spans."""
MIN_WEIGHT = 0.05
"""Smallest weight of a middle pixel within the span."""
MAX_RESIDUAL_RADII = 0.45
"""Maximum root mean square distance of the middle pixels from a smooth axis, in radii r. At a crossing it is more."""
MAX_OFFSET_RADII = 0.8
"""Maximum distance of the smooth axis from its middle pixel, in radii r."""
MIN_REACH = 0.4
"""Minimum distance up to which middle pixels lie on both sides along an axis, in spans."""
MIN_MIDDLES = 6
"""Minimum number of middle pixels from which an axis is determined."""


def across(directions: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return directions (..., 2) in an image, turned by a right angle."""
    return np.stack([-directions[..., 1], directions[..., 0]], axis=-1)


@dataclass(frozen=True, eq=False)
class PixelPairs:
    """Pairs of near middle pixels, in both orders, and each pixel with itself."""

    first: NDArray[np.intp]
    """(P,) index of the first pixel of each pair."""
    second: NDArray[np.intp]
    """(P,) index of the second pixel."""
    count: int
    """Number of pixels."""

    @classmethod
    def within(cls, points: NDArray[np.float64], distance: float) -> Self:
        """Return the pairs of points (N, 2) up to a distance, pixels."""
        pairs = KDTree(points).query_pairs(distance, output_type="ndarray")
        each = np.arange(len(points))
        return cls(
            np.concatenate([pairs[:, 0], pairs[:, 1], each]),
            np.concatenate([pairs[:, 1], pairs[:, 0], each]),
            len(points),
        )

    def sum(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the sum (N,) of values (P,) of the pairs over the second pixels."""
        return np.asarray(np.bincount(self.first, values, minlength=self.count), dtype=np.float64)

    def median(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the upper median (N,) of values (N,) over the second pixels."""
        order = np.lexsort((values[self.second], self.first))
        start = np.searchsorted(self.first[order], np.arange(self.count))
        number = np.bincount(self.first, minlength=self.count)
        return values[self.second[order[start + number // 2]]]


@dataclass(frozen=True, eq=False)
class Axes:
    """A parabola through the middle pixels near each of N middle pixels."""

    position: NDArray[np.float64]
    """(N, 2) point of the parabola at the middle pixel, pixels."""
    tangent: NDArray[np.float64]
    """(N, 2) unit vectors along it."""
    curvature: NDArray[np.float64]
    """(N,) quadratic coefficients, 1/pixel."""
    offset: NDArray[np.float64]
    """(N,) distances of the parabola from the middle pixel, pixels."""
    residual: NDArray[np.float64]
    """(N,) root mean square distances of the near middle pixels from it, pixels."""
    reach: NDArray[np.float64]
    """(N,) distances up to which they lie on both sides, in spans."""
    number: NDArray[np.intp]
    """(N,) numbers of the near middle pixels."""
    along: NDArray[np.float64]
    """(P,) distance of the second pixel of each pair along the main axis at the first one, pixels."""

    def slope_of(self, values: NDArray[np.float64], pairs: PixelPairs) -> NDArray[np.float64]:
        """Return the slopes (N,) of the straight lines through values (N,) near each middle pixel, per pixel.

        Args:
            values: Value at each middle pixel.
            pairs: Pairs from which the axes were fitted.
        """
        difference = values[pairs.second] - values[pairs.first]
        mean_s = pairs.sum(self.along) / self.number
        mean_d = pairs.sum(difference) / self.number
        variance = pairs.sum(self.along**2) / self.number - mean_s**2
        covariance = pairs.sum(self.along * difference) / self.number - mean_s * mean_d
        return np.where(variance > 0, covariance / np.where(variance > 0, variance, 1.0), 0.0)

    def is_smooth(self, r_px: float) -> NDArray[np.bool_]:
        """Return where (N,) a single smooth axis runs through the middle pixels, for a radius in pixels."""
        return (
            (self.residual < MAX_RESIDUAL_RADII * r_px)
            & (np.abs(self.offset) < MAX_OFFSET_RADII * r_px)
            & (self.reach > MIN_REACH)
            & (self.number >= MIN_MIDDLES)
        )


def fit_axes(middles: NDArray[np.float64], pairs: PixelPairs, span: float) -> Axes:
    """Fit a parabola at each middle pixel to those near it, in the direction of their main axis.

    Args:
        middles: (N, 2) middle pixels.
        pairs: Pairs of near middle pixels.
        span: Maximum distance of a pair, pixels.
    """
    n = pairs.count
    delta = middles[pairs.second] - middles[pairs.first]
    number = np.bincount(pairs.first, minlength=n)
    mean_x, mean_y = (pairs.sum(delta[:, k]) / number for k in (0, 1))
    xx = pairs.sum(delta[:, 0] ** 2) / number - mean_x**2
    yy = pairs.sum(delta[:, 1] ** 2) / number - mean_y**2
    xy = pairs.sum(delta[:, 0] * delta[:, 1]) / number - mean_x * mean_y
    angle = np.arctan2(2 * xy, xx - yy) / 2
    along = np.column_stack([np.cos(angle), np.sin(angle)])
    sideways = across(along)
    s = (delta * along[pairs.first]).sum(axis=1)
    y = (delta * sideways[pairs.first]).sum(axis=1)
    weight = np.maximum(1 - (s / (SPAN_MARGIN * span)) ** 2, MIN_WEIGHT)
    moments = np.stack([pairs.sum(weight * s**k) for k in range(5)])
    # a tiny diagonal keeps the equations of few pixels solvable
    normal_matrix = np.moveaxis(moments[np.add.outer(np.arange(3), np.arange(3))], -1, 0) + 1e-6 * np.eye(3)
    right = np.stack([pairs.sum(weight * y * s**k) for k in range(3)], axis=1)
    constant, slope, quadratic = np.linalg.solve(normal_matrix, right[..., None])[..., 0].T
    fitted = constant[pairs.first] + s * (slope[pairs.first] + s * quadratic[pairs.first])
    tangent = along + slope[:, None] * sideways
    lowest = np.zeros(n)
    highest = np.zeros(n)
    np.minimum.at(lowest, pairs.first, s)
    np.maximum.at(highest, pairs.first, s)
    return Axes(
        position=middles + constant[:, None] * sideways,
        tangent=tangent / np.linalg.norm(tangent, axis=1, keepdims=True),
        curvature=quadratic,
        offset=constant,
        residual=np.sqrt(pairs.sum(weight * (y - fitted) ** 2) / moments[0]),
        reach=np.minimum(-lowest, highest) / span,
        number=number,
        along=s,
    )
