"""Border offset: how far the depth images show the sides of strings beyond where they are.

The windows of a stereo camera widen an object towards a background with less texture, and narrow it towards one with
more. The ends of a string move by as much as its sides, but only the sides show by how much: their distance is known.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from recognition.geometry.polyline import arc_length, unit_vectors
from recognition.preprocessing.lines_of_sight import depths_at
from recognition.preprocessing.normals import NormalCloud
from recognition.refinement.resting_height import is_away_from_others

Points = NDArray[np.float64]

AWAY_RADII = 6.0
"""Minimum distance of an examined position from other strands, seen from above, in radii r."""
FROM_END_RADII = 3.0
"""Minimum distance of an examined position from the ends of its line, in radii r."""
MAX_LEVEL_RADII = 0.5
"""Maximum distance of an examined position from one radius above the table, in radii r."""
MAX_POSITIONS = 60
"""Maximum number of examined positions, evenly spread over all lines."""
MIN_POSITIONS = 10
"""Minimum number of examined positions. With fewer, the offset counts as zero."""
PROFILE_RADII = 2.0
"""Length of the examined profile from the centre line to one side, in radii of the string."""
N_SAMPLES = 24
"""Number of samples of a profile."""
MAX_OFFSET_RADII = 0.75
"""Maximum border offset, in radii r. More is no effect of windows."""


def measure_border_offset(
    lines: Sequence[Points], radii: NDArray[np.float64], views: Sequence[NormalCloud], table_z_m: float, r: float
) -> float:
    """Return the distance by which the depth images show the sides of resting strings outside their tubes, metres.

    Each view is sampled from the centre line towards the upper side of the string. A sample shows the string if what it
    measures is more than a radius above the table. The mean share of such samples is the half width that is shown.

    Args:
        lines: (N_k, 3) points of each centre line, metres, base frame.
        radii: (K,) radius of each string, metres.
        views: Registered views with their depth images.
        table_z_m: Height of the table, metres, base frame.
        r: Expected radius, metres.

    Returns:
        The offset, metres. It is negative if strings are shown too narrow, and 0 if too little shows it.
    """
    points, tangents, radius = _resting_positions(lines, radii, table_z_m, r)
    if len(points) < MIN_POSITIONS:
        return 0.0
    hits = np.zeros(N_SAMPLES)
    count = np.zeros(N_SAMPLES)
    for view in views:
        if view.image is None or view.T_base_camera is None:
            continue
        is_seen, is_hit = _sample_profiles(view, points, tangents, radius, table_z_m)
        hits += is_hit.sum(axis=0)
        count += is_seen.sum(axis=0)
    if count.min() < MIN_POSITIONS:
        return 0.0
    half_width = float((hits / count).mean()) * PROFILE_RADII
    return float(np.clip(half_width - 1, -MAX_OFFSET_RADII, MAX_OFFSET_RADII)) * r


def _resting_positions(
    lines: Sequence[Points], radii: NDArray[np.float64], table_z_m: float, r: float
) -> tuple[Points, Points, NDArray[np.float64]]:
    """Return points (P, 3) of resting strings away from others, the unit tangents (P, 3) and the radii (P,) there."""
    points = np.vstack(lines)
    tangents = unit_vectors(np.vstack([np.gradient(line, axis=0) for line in lines]))
    radius = np.repeat(radii, [len(line) for line in lines])
    from_end = np.concatenate([_distance_from_ends(line) for line in lines])
    usable = is_away_from_others(lines, AWAY_RADII * r) & (from_end > FROM_END_RADII * r)
    usable &= np.abs(points[:, 2] - table_z_m - radius) < MAX_LEVEL_RADII * r
    chosen = np.flatnonzero(usable)
    step = max(-(-len(chosen) // MAX_POSITIONS), 1)
    chosen = chosen[::step]
    return points[chosen], tangents[chosen], radius[chosen]


def _distance_from_ends(line: Points) -> NDArray[np.float64]:
    """Return the distance (N,) of each point along a line from its nearer end, metres."""
    s = arc_length(line)
    return np.minimum(s, s[-1] - s)


def _sample_profiles(
    view: NormalCloud, points: Points, tangents: Points, radius: NDArray[np.float64], table_z_m: float
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return which samples (P, S) of the profiles of a view are measured, and which of them show the string."""
    assert view.image is not None
    assert view.T_base_camera is not None
    camera = view.T_base_camera[:3, 3]
    aside = unit_vectors(np.cross(tangents, points - camera))
    # the table is far behind the upper side only
    aside *= np.where(aside[:, 2] < 0, -1.0, 1.0)[:, None]
    share = PROFILE_RADII * (np.arange(N_SAMPLES) + 0.5) / N_SAMPLES
    samples = points[:, None] + (share[None, :, None] * radius[:, None, None]) * aside[:, None]
    depths = depths_at(samples.reshape(-1, 3), view.image, view.T_base_camera)
    own_m = depths.own_m.reshape(samples.shape[:2])
    measured_m = depths.measured_m.reshape(samples.shape[:2])
    is_seen = measured_m > 0
    # the measured point lies on the ray of the sample
    height = camera[2] + (samples[..., 2] - camera[2]) * measured_m / np.where(is_seen, own_m, 1.0) - table_z_m
    return is_seen, is_seen & (height > radius[:, None])
