"""Distances of line segments from each other and from boxes, for many segments at once."""

import numpy as np
from numpy.typing import NDArray

_ROUNDS = 14
"""Number of bisections, which give the nearest point of a segment to 1e-4 of its length."""


def segment_distances(
    a: NDArray[np.float64], b: NDArray[np.float64], c: NDArray[np.float64], d: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the distance (...) of each segment from `a` to `b` from the one from `c` to `d`, all (..., 3)."""
    u, v, w = b - a, d - c, a - c
    uu, vv, uv = (u * u).sum(-1), (v * v).sum(-1), (u * v).sum(-1)
    uw, vw = (u * w).sum(-1), (v * w).sum(-1)
    tiny = np.finfo(np.float64).tiny
    denominator = uu * vv - uv * uv
    # for parallel segments, any point of the first will do, with the nearest point of the second
    parallel = denominator <= 1e-12 * uu * vv
    s = np.where(parallel, 0.0, (uv * vw - vv * uw) / np.where(parallel, 1.0, denominator)).clip(0.0, 1.0)
    t = ((uv * s + vw) / np.maximum(vv, tiny)).clip(0.0, 1.0)
    s = ((uv * t - uw) / np.maximum(uu, tiny)).clip(0.0, 1.0)
    # the clipping above may have moved the partner of an end of the second segment
    t = ((uv * s + vw) / np.maximum(vv, tiny)).clip(0.0, 1.0)
    return np.linalg.norm(w + s[..., None] * u - t[..., None] * v, axis=-1)


def box_distances(
    a: NDArray[np.float64],
    b: NDArray[np.float64],
    lowest: NDArray[np.float64],
    highest: NDArray[np.float64],
    beyond_m: float,
) -> NDArray[np.float64]:
    """Return the signed distance (...) of each segment from a box.

    Args:
        a: Starts of the segments (..., 3).
        b: Ends of the segments (..., 3).
        lowest: Lowest corner of the box (3,).
        highest: Highest corner of the box (3,).
        beyond_m: Distance from which on the result may be any value between this and the true distance.

    Returns:
        Distances, metres. A negative value is the depth of the segment's deepest point in the box.
    """
    u = b - a
    # no point of a segment is nearer than its middle less half its length
    result = _depth(a + 0.5 * u, lowest, highest) - 0.5 * np.linalg.norm(u, axis=-1)
    near = result <= beyond_m
    result[near] = _nearest(a[near], u[near], lowest, highest)
    return result


def _nearest(
    a: NDArray[np.float64], u: NDArray[np.float64], lowest: NDArray[np.float64], highest: NDArray[np.float64]
) -> NDArray[np.float64]:
    # the signed distance from a convex box is convex along the segment, so its slope leads to the minimum
    low, high = np.zeros(len(a)), np.ones(len(a))
    step = 0.5**_ROUNDS / 4
    for _ in range(_ROUNDS):
        middle = (low + high) / 2
        ahead, before = (_depth(a + (middle + e)[:, None] * u, lowest, highest) for e in (step, -step))
        rising = ahead > before
        low, high = np.where(rising, low, middle), np.where(rising, middle, high)
    arc_lengths = np.stack([low, high])
    return _depth(a + arc_lengths[..., None] * u, lowest, highest).min(axis=0)


def _depth(p: NDArray[np.float64], lowest: NDArray[np.float64], highest: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the signed distances (...) of points (..., 3) from a box."""
    beyond = np.maximum(lowest - p, p - highest)
    outside = beyond.clip(min=0.0)
    return np.sqrt(np.einsum("...i,...i->...", outside, outside)) + beyond.max(axis=-1).clip(max=0.0)
