"""Localisation of the end of a string in the depth images: where the lines of sight begin to pass the string.

The registered surface is too short at an end. The filters of flying pixels and outliers remove about a pixel there, and
steep views from afar have large pixels. The depth images have no such loss, and they also show where no string is.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from recognition.geometry.polyline import arc_length
from recognition.preprocessing.flying_pixels import DepthImage
from recognition.preprocessing.normals import NormalCloud
from recognition.refinement.end_localisation import EndCurve, Points, move_end

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
EXTENSION_POINTS = 4
"""Number of points on the longest extension of an end, from which the distance of other strands is measured."""
MIN_SLOPE = 1e-9
"""Minimum slope of the parabola at an end. Below it, the points of the line coincide and show no direction."""
MIN_ACROSS_SQUARE = 1e-12
"""Lower limit of the squared component of a ray across the axis. It prevents division by zero along the axis."""


@dataclass(frozen=True, eq=False)
class _Axis:
    """Axis of a string beyond the first point of its line."""

    origin: Points
    """(3,) first point of the line, metres, base frame."""
    outward: Points
    """(3,) unit vector out of the line, base frame."""
    r: float
    """Radius of the string, metres."""


@dataclass(frozen=True, eq=False)
class _LinesOfSight:
    """Lines of sight of M pixels of an image, `camera + depth * ray`, and their positions along an axis."""

    camera: Points
    """(3,) position of the camera, metres, base frame."""
    rays: Points
    """(M, 3) directions, base frame. The component along the optical axis is 1."""
    depth: NDArray[np.float64]
    """(M,) measured depth, metres; 0 where nothing was measured."""
    camera_s: float
    """Position of the camera along the axis, metres."""
    ray_s: NDArray[np.float64]
    """(M,) change of the position along the axis with the depth."""

    def s_at(self, depth: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the position (M,) along the axis at a depth (M,) of each line of sight, metres."""
        return self.camera_s + depth * self.ray_s


@dataclass(frozen=True, eq=False)
class _TubeChords:
    """Where M lines of sight pass an endless tube around the axis."""

    entry: NDArray[np.float64]
    """(M,) depth at which the line of sight enters the tube, metres; that of its nearest point if it passes outside."""
    leave: NDArray[np.float64]
    """(M,) depth at which it leaves the tube, metres."""
    distance_square: NDArray[np.float64]
    """(M,) squared distance between the line of sight and the axis, square metres."""


@dataclass(frozen=True, eq=False)
class _Sightings:
    """M lines of sight that show the string or the space beyond its end."""

    s: NDArray[np.float64]
    """(M,) position along the axis, metres; positive beyond the first point of the line."""
    is_hit: NDArray[np.float64]
    """(M,) 1 for a hit, 0 for a miss."""


def localise_end_in_images(
    line: Points, views: Sequence[NormalCloud], other_strands: KDTree | None, r: float, border_offset_m: float = 0.0
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
        border_offset_m: Distance by which the images show the string too long, metres (see `measure_border_offset`).

    Returns:
        (K, 3) centre line from the end of the string, metres, base frame. The line is unchanged if another strand is
        near the end, or if the images do not show the string on one side of the end and free space on the other.
    """
    curve = EndCurve.fit(line, r)
    if np.linalg.norm(curve.slope) < MIN_SLOPE or float(np.median(np.diff(arc_length(line)))) <= 0:
        return line
    axis = _Axis(curve.origin, curve.outward, r)
    if other_strands is not None:
        steps = np.linspace(0, MAX_MOVE_RADII * r, EXTENSION_POINTS)
        distance, _ = other_strands.query(axis.origin + steps[:, None] * axis.outward)
        if distance.min() < FREE_END_RADII * r:
            return line
    sightings = [
        _sight(view.image, view.T_base_camera, axis, other_strands)
        for view in views
        if view.image is not None and view.T_base_camera is not None
    ]
    if not sightings:
        return line
    s = np.concatenate([seen.s for seen in sightings])
    is_hit = np.concatenate([seen.is_hit for seen in sightings])
    end = _find_transition(s, is_hit, r)
    if end is None:
        return line
    return move_end(line, curve, end - border_offset_m)


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
    image: DepthImage, T_base_camera: NDArray[np.float64], axis: _Axis, other_strands: KDTree | None
) -> _Sightings:
    """Return the hits and the misses of one image around the end."""
    sight = _lines_of_sight(image, T_base_camera, axis)
    chords = _pass_tube(sight, axis)
    counts = (sight.depth > 0) & (chords.distance_square < (CORRIDOR_RADII * axis.r) ** 2)
    if other_strands is not None:
        points = sight.camera + sight.depth[:, None] * sight.rays
        distance, _ = other_strands.query(points, distance_upper_bound=OTHER_STRING_RADII * axis.r)
        counts &= ~np.isfinite(distance)
    behind_entry = sight.depth - chords.entry
    is_hit = counts & (np.abs(behind_entry) < HIT_RADII * axis.r)
    is_miss = counts & (behind_entry >= HIT_RADII * axis.r)

    measured_s = sight.s_at(sight.depth)
    # A line of sight is free up to the measured point. If it leads towards the string, it may end on the end face.
    towards_string_s = np.maximum(measured_s, sight.s_at(chords.leave))
    free_s = np.where(sight.ray_s < 0, towards_string_s, sight.s_at(chords.entry))
    s = np.concatenate([measured_s[is_hit], free_s[is_miss]])
    return _Sightings(s, np.repeat([1.0, 0.0], [int(is_hit.sum()), int(is_miss.sum())]))


def _lines_of_sight(image: DepthImage, T_base_camera: NDArray[np.float64], axis: _Axis) -> _LinesOfSight:
    """Return the lines of sight of the pixels around the examined part of the axis."""
    R = T_base_camera[:3, :3]
    camera = T_base_camera[:3, 3]
    rows, columns = _pixels_around(image, (_window_corners(axis) - camera) @ R)
    depth = np.asarray(image.depth[rows, columns] * image.depth_unit_m, dtype=np.float64)
    rays = np.column_stack([columns, rows, np.ones(len(rows))]) @ np.linalg.inv(image.K).T @ R.T
    camera_s = float((camera - axis.origin) @ axis.outward)
    return _LinesOfSight(camera, rays, depth, camera_s, rays @ axis.outward)


def _pass_tube(sight: _LinesOfSight, axis: _Axis) -> _TubeChords:
    """Return where the lines of sight pass the tube. They are compared with it in the plane across the axis."""
    camera_across = sight.camera - axis.origin - sight.camera_s * axis.outward
    rays_across = sight.rays - sight.ray_s[:, None] * axis.outward
    square = np.maximum(np.vecdot(rays_across, rays_across), MIN_ACROSS_SQUARE)
    nearest = -(rays_across @ camera_across) / square
    distance_square = camera_across @ camera_across - square * nearest**2
    half_chord = np.sqrt(np.maximum(axis.r * axis.r - distance_square, 0.0) / square)
    return _TubeChords(nearest - half_chord, nearest + half_chord, distance_square)


def _window_corners(axis: _Axis) -> Points:
    """Return points (12, 3) on a box around the examined part of the axis."""
    aside = axis.r * np.vstack([np.eye(3), -np.eye(3)])
    inner, outer = (axis.origin + s * axis.r * axis.outward for s in (-WINDOW_RADII, WINDOW_RADII))
    return np.vstack([inner + aside, outer + aside])


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
    s = s[order]
    is_hit = is_hit[order]
    if min(is_hit.sum(), (1 - is_hit).sum()) < MIN_PIXELS:
        return None
    # Entry k of `errors` is the number of misses among the first k sightings and of hits among the others.
    misses_before = np.concatenate([[0.0], np.cumsum(1 - is_hit)])
    hits_before = np.concatenate([[0.0], np.cumsum(is_hit)])
    errors = misses_before + is_hit.sum() - hits_before
    k = int(errors.argmin())
    if k in (0, len(s)):
        return None
    first = float(s[k - 1] + s[k]) / 2 - TRANSITION_RADII * r
    last = first + 2 * TRANSITION_RADII * r
    edges = np.linspace(first, last, N_BINS + 1)
    count, _ = np.histogram(s, edges)
    hits, _ = np.histogram(s, edges, weights=is_hit)
    half = N_BINS // 2
    if first < -limit or last > limit or min(count[:half].sum(), count[half:].sum()) < MIN_PIXELS:
        return None
    seen = np.flatnonzero(count)
    share = np.interp(np.arange(N_BINS), seen, hits[seen] / count[seen])
    return float(np.clip(first + share.mean() * (last - first), -MAX_MOVE_RADII * r, MAX_MOVE_RADII * r))
