"""Heights of resting strings: where a string rests, its centre line is one radius above what it rests on.

The height of a string is what a stereo camera measures worst: windows that contain string and table lower it, by an
amount that changes along the string. But most of a string rests, and then its height is known.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from recognition.geometry.polyline import arc_length
from recognition.refinement.tube_fit import SIGMA_PER_MAD

Points = NDArray[np.float64]

RESTING_SIGMA_RADII = 0.03
"""Standard deviation of the height of a resting string, in radii r: neither table nor string is quite even."""
MAX_LEVEL_RADII = 0.5
"""Maximum distance of the measured height of resting strings from one radius above their support, in radii r."""
MIN_RESTING_SHARE = 0.15
"""Minimum share of the points that rest. With fewer, heights stay as measured."""
MIN_RESTING_POINTS = 10
"""Minimum number of points that rest."""
AWAY_RADII = 6.0
"""Minimum distance of a resting point from other strands, seen from above, in radii r.

Near a crossing, the upper strand does not rest.
"""
MAX_RIPPLES = 2.5
"""Maximum distance of the height of a resting point from the level of all, in standard deviations of these heights."""
RIPPLE_MARGIN_RADII = 0.05
"""Additional distance, in radii r."""
MIN_RIPPLE_RADII = 0.01
"""Minimum standard deviation of the heights, in radii r."""
MAX_EXCESS_SCATTERS = 2.0
"""Maximum height that resting strings are measured too high, in standard deviations of patches of the table.

Noise and warp of the table explain so much. A string that is higher lies on something.
"""
N_PASSES = 3
"""Number of passes in which level and standard deviation are measured."""


@dataclass(frozen=True, eq=False)
class RestingHeights:
    """Heights of the points of all lines where their strings rest."""

    height_m: NDArray[np.float64]
    """(N,) height of each point if it rests, metres, base frame."""
    stiffness: NDArray[np.float64]
    """(N,) weight of this height, relative to the weight of the surface beside the point; 0 far from this height."""
    lost_m: float = 0.0
    """Distance by which resting strings are measured too low, metres. It is negative if they are measured too high."""
    ripple_m: float = 0.0
    """Standard deviation of the measured heights where strings rest, metres; 0 if too few points rest."""


def find_resting_heights(
    lines: Sequence[Points],
    radii: NDArray[np.float64],
    floors: NDArray[np.float64],
    r: float,
    table_scatter_m: float = 0.0,
) -> RestingHeights:
    """Find where strings rest, and how far their measured heights are from where resting strings are.

    Args:
        lines: (N_k, 3) points of each centre line, metres, base frame.
        radii: (K,) radius of each string, metres.
        floors: (K,) height of what each string rests on, metres, base frame.
        r: Expected radius, metres.
        table_scatter_m: Standard deviation of patches of the table, metres. It limits how much strings are lowered.

    Returns:
        The heights. If too few points rest, no point has a stiffness, and nothing is lost.
    """
    number = np.repeat(np.arange(len(lines)), [len(line) for line in lines])
    height_m = (floors + radii)[number]
    level = (np.vstack(lines)[:, 2] - height_m) / r
    is_away = _is_away(lines, AWAY_RADII * r)
    resting = is_away & (np.abs(level) < MAX_LEVEL_RADII)
    stiffness = np.zeros(len(level))
    if resting.sum() < max(MIN_RESTING_SHARE * len(level), MIN_RESTING_POINTS):
        return RestingHeights(height_m, stiffness)
    middle = 0.0
    ripple = MIN_RIPPLE_RADII
    for _ in range(N_PASSES):
        middle = float(np.median(level[resting]))
        ripple = max(SIGMA_PER_MAD * float(np.median(np.abs(level[resting] - middle))), MIN_RIPPLE_RADII)
        resting = is_away & (np.abs(level - middle) < MAX_RIPPLES * ripple)
    distance = (level - middle) / (MAX_RIPPLES * ripple + RIPPLE_MARGIN_RADII)
    tukey = np.maximum(1 - distance**2, 0.0) ** 2
    stiffness = tukey * (ripple / RESTING_SIGMA_RADII) ** 2
    lost_m = max(-middle * r, -MAX_EXCESS_SCATTERS * table_scatter_m)
    return RestingHeights(height_m, stiffness, lost_m, ripple_m=ripple * r)


def add_lost_height(z_m: NDArray[np.float64], floor_m: float, top_m: float, lost_m: float) -> NDArray[np.float64]:
    """Return measured heights (N,) with the height that was lost, metres.

    A point as high as the top of a resting string gains all of it, also above this top. A lower point gains a share in
    proportion to its height.

    Args:
        z_m: (N,) heights, metres, base frame.
        floor_m: Height of the table, metres, base frame.
        top_m: Height of the top of a resting string above the table, metres.
        lost_m: Height that the top lost, metres.
    """
    return z_m + lost_m * np.clip((z_m - floor_m) / (top_m - lost_m), 0.0, 1.0)


def _is_away(lines: Sequence[Points], distance_m: float) -> NDArray[np.bool_]:
    """Return which points (N,) are away from all other strands and other parts of their own, seen from above."""
    number = np.repeat(np.arange(len(lines)), [len(line) for line in lines])
    along = np.concatenate([arc_length(line) for line in lines])
    i, j = KDTree(np.vstack(lines)[:, :2]).query_pairs(distance_m, output_type="ndarray").T
    is_other = (number[i] != number[j]) | (np.abs(along[i] - along[j]) > 2 * distance_m)
    is_away = np.ones(len(number), dtype=bool)
    is_away[i[is_other]] = False
    is_away[j[is_other]] = False
    return is_away
