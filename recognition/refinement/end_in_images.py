"""Localisation of the end of a string in the depth images: where the lines of sight begin to pass the string.

The registered surface is too short at an end. The filters of flying pixels and outliers remove about a pixel there, and
steep views from afar have large pixels. The depth images have no such loss, and they also show where no string is.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from recognition.geometry.polyline import arc_length, fit_end_parabola
from recognition.preprocessing.flying_pixels import DepthImage
from recognition.preprocessing.normals import NormalCloud
from recognition.refinement.end_localisation import END_FIT_RADII, Points, move_end

WINDOW_RADII = 2.5
"""Length of the axis that is examined on both sides of the first point of the line, in radii of the string."""
CORRIDOR_RADII = 0.6
"""Maximum distance between a line of sight and the axis, in radii. Farther out, edge noise of the sides is counted."""
HIT_RADII = 1.0
"""Maximum difference between the measured depth and the depth of the tube at a hit, in radii.

The table is 1.8 r or more behind the tube in the corridor. Half of it divides flying pixels equally.
"""
OTHER_STRING_RADII = 1.35
"""Maximum distance of a measured point from the centre line of another strand on which it lies, in radii."""
FREE_END_RADII = 3.0
"""Minimum distance of another strand from the end and its extension, in radii. Below, above or beside a nearer strand,
the images do not show free space beyond the end."""
OWN_END_RADII = 6.0
"""Length of the line that belongs to the end, in radii. The rest of the line counts as another strand."""
TRANSITION_RADII = 1.0
"""Half length of the part around the end in which the share of hits is averaged, in radii."""
N_BINS = 8
"""Number of bins in this part. Each bin has the same weight."""
MIN_PIXELS = 3
"""Minimum number of pixels on each side of the end. With fewer, the images do not show the end."""
MAX_MOVE_RADII = 1.5
"""Maximum distance by which the images move an end, in radii."""


def localise_end_in_images(
    line: Points, views: Sequence[NormalCloud], other_strands: KDTree | None, r: float
) -> Points:
    """Extend or shorten a centre line at its first point, so that it begins where the images show the end.

    A line of sight that meets the extrapolated tube is a hit if the measured depth is that of the tube, and a miss if
    it is larger. First, the end is placed so that the fewest hits lie beyond it and the fewest misses before it. Then
    the share of hits around this position gives the end to a fraction of a pixel.

    Args:
        line: (N, 3) centre line, metres, base frame.
        views: Registered views with their depth images.
        other_strands: Centre points of the other strands, and of this strand away from the end. Pixels near them are
            ignored. None means that there are none.
        r: Radius of the string, metres.

    Returns:
        (K, 3) centre line from the end of the string, metres, base frame. The line is unchanged if another strand is
        near the end, or if the images do not show the string on one side of the end and free space on the other.
    """
    terms = fit_end_parabola(line, END_FIT_RADII * r, r)
    length = float(np.linalg.norm(terms[1]))
    if length < 1e-9 or float(np.median(np.diff(arc_length(line)))) <= 0:
        return line
    axis = np.array([terms[0], -terms[1] / length])
    if other_strands is not None:
        extension = axis[0] + np.linspace(0, MAX_MOVE_RADII * r, 4)[:, None] * axis[1]
        if other_strands.query(extension)[0].min() < FREE_END_RADII * r:
            return line
    sightings = [
        _sight(view.image, view.T_base_camera, axis, other_strands, r)
        for view in views
        if view.image is not None and view.T_base_camera is not None
    ]
    if not sightings:
        return line
    s, is_hit = np.hstack(sightings)
    end = _find_transition(s, is_hit, r)
    return line if end is None else move_end(line, terms, end, r)


def other_strand_points(lines: Sequence[Points], number: int, r: float) -> Points:
    """Return the centre points (K, 3) of all other lines, and of line `number` away from its first point."""
    line = lines[number]
    far = line[arc_length(line) > OWN_END_RADII * r]
    return np.vstack([far, *(other for k, other in enumerate(lines) if k != number)])


def other_strand_tree(lines: Sequence[Points], number: int, r: float) -> KDTree | None:
    """Return the tree of `other_strand_points`, or None without any."""
    points = other_strand_points(lines, number, r)
    return KDTree(points) if len(points) else None


def _sight(
    image: DepthImage, T_base_camera: NDArray[np.float64], axis: Points, other_strands: KDTree | None, r: float
) -> NDArray[np.float64]:
    """Return the sightings (2, M) of one image: position along the axis, metres, and 1 for a hit or 0 for a miss.

    `axis` holds the first point of the line and the outward direction.
    """
    origin, outward = axis
    R, camera = T_base_camera[:3, :3], T_base_camera[:3, 3]
    rows, columns = _pixels_around(image, (_window_corners(axis, r) - camera) @ R)
    depth = image.depth[rows, columns] * image.depth_unit_m
    rays = np.column_stack([columns, rows, np.ones(len(rows))]) @ np.linalg.inv(image.K).T @ R.T
    # A line of sight `camera + depth * ray` and the tube are compared in the plane across the axis.
    along, camera_along = rays @ outward, float((camera - origin) @ outward)
    across, camera_across = rays - along[:, None] * outward, camera - origin - camera_along * outward
    square = np.maximum(np.vecdot(across, across), 1e-12)
    nearest = -(across @ camera_across) / square
    distance_square = camera_across @ camera_across - square * nearest**2
    is_in_corridor = (depth > 0) & (distance_square < (CORRIDOR_RADII * r) ** 2)
    half_chord = np.sqrt(np.maximum(r * r - distance_square, 0.0) / square)
    entry, leave = nearest - half_chord, nearest + half_chord
    points = camera + depth[:, None] * rays
    is_hit = is_in_corridor & (np.abs(depth - entry) < HIT_RADII * r)
    is_miss = is_in_corridor & (depth - entry >= HIT_RADII * r)
    if other_strands is not None:
        distance, _ = other_strands.query(points, distance_upper_bound=OTHER_STRING_RADII * r)
        is_free = ~np.isfinite(distance)
        is_hit, is_miss = is_hit & is_free, is_miss & is_free
    measured_s, entry_s, leave_s = (camera_along + z * along for z in (depth, entry, leave))
    # A line of sight is free up to the measured point. If it leads towards the string, it may end on the end face.
    free_s = np.where(along < 0, np.maximum(measured_s, leave_s), entry_s)
    s = np.concatenate([measured_s[is_hit], free_s[is_miss]])
    return np.array([s, np.repeat([1.0, 0.0], [int(is_hit.sum()), int(is_miss.sum())])])


def _window_corners(axis: Points, r: float) -> Points:
    """Return points (12, 3) on a box around the examined part of the axis."""
    aside = r * np.vstack([np.eye(3), -np.eye(3)])
    return np.vstack([axis[0] + s * r * axis[1] + aside for s in (-WINDOW_RADII, WINDOW_RADII)])


def _pixels_around(image: DepthImage, corners: Points) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the rows and columns of all pixels in the box around the corners (12, 3), camera frame."""
    height, width = image.depth.shape
    if (corners[:, 2] <= 0).any():
        return np.empty(0, dtype=np.intp), np.empty(0, dtype=np.intp)
    pixels = corners @ image.K.T
    pixels = pixels[:, :2] / pixels[:, 2:]
    low = np.clip(np.floor(pixels.min(axis=0)), 0, (width, height)).astype(np.intp)
    high = np.clip(np.ceil(pixels.max(axis=0)) + 1, 0, (width, height)).astype(np.intp)
    rows, columns = np.mgrid[low[1] : high[1], low[0] : high[0]]
    return rows.ravel(), columns.ravel()


def _find_transition(s: NDArray[np.float64], is_hit: NDArray[np.float64], r: float) -> float | None:
    """Return the position of the end along the axis, metres, or None if the sightings do not show it.

    Args:
        s: (M,) positions of the sightings along the axis, metres.
        is_hit: (M,) 1 for a hit, 0 for a miss.
        r: Radius of the string, metres.
    """
    limit = WINDOW_RADII * r
    order = np.argsort(s)
    order = order[np.abs(s[order]) < limit]
    s, is_hit = s[order], is_hit[order]
    if min(is_hit.sum(), (1 - is_hit).sum()) < MIN_PIXELS:
        return None
    # Entry k is the number of misses among the first k sightings and of hits among the others.
    errors = np.concatenate([[0.0], np.cumsum(1 - is_hit)]) + is_hit.sum() - np.concatenate([[0.0], np.cumsum(is_hit)])
    k = int(errors.argmin())
    if k in (0, len(s)):
        return None
    first = float(s[k - 1] + s[k]) / 2 - TRANSITION_RADII * r
    last = first + 2 * TRANSITION_RADII * r
    edges = np.linspace(first, last, N_BINS + 1)
    count, hits = np.histogram(s, edges)[0], np.histogram(s, edges, weights=is_hit)[0]
    half = N_BINS // 2
    if first < -limit or last > limit or min(count[:half].sum(), count[half:].sum()) < MIN_PIXELS:
        return None
    seen = np.flatnonzero(count)
    share = np.interp(np.arange(N_BINS), seen, hits[seen] / count[seen])
    return float(np.clip(first + share.mean() * (last - first), -MAX_MOVE_RADII * r, MAX_MOVE_RADII * r))
