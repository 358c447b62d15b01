"""Localisation of the end of a string: the farthest surface around the extrapolated centre line."""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from recognition.geometry.polyline import arc_length, fit_end_parabola

Points = NDArray[np.float64]

END_FIT_RADII = 4.0
"""Length of centre line from which an end is extrapolated, in radii of the string."""
MAX_EXTENSION_RADII = 3.0
"""Maximum length by which a centre line is extended, in radii of the string."""
EDGE_PERCENTILE = 95.0
"""Percentile of the surface positions along the axis, over the last 2 r of surface, that is taken as the end.

Surface beyond the percentile is depth noise. On simulated scans and scans from other sources, the error of the end was
below half a millimetre, without a bias.
"""
MAX_HOLE_RADII = 0.5
"""Maximum length of a hole in the surface along the axis, in radii of the string.

The string ends at a longer hole. The surface after the hole belongs to another object.
"""
MIN_END_POINTS = 5
"""Minimum number of surface points around the extrapolated line. With fewer points, the line is not changed."""
MAX_COVER_RADII = 8.0
"""Maximum length of the extrapolated line that another strand covers, in radii of the string."""
MAX_AHEAD_RADII = 1.5
"""Maximum distance from an end to the strand that covers its extension, in radii of the string."""
MIN_ABOVE_RADII = 1.0
"""Minimum height of the centre line of a covering strand above the extrapolated line, in radii of the string."""


def localise_end(line: Points, surface: Points, normals: Points, r: float) -> Points:
    """Extend or shorten a centre line at its first point, so that it begins at the end of the string.

    A parabola through the first 4 r of the line extrapolates the line. The end of the string is the farthest surface
    that lies around the parabola at the distance r. The spacing of the points stays about the same.

    Args:
        line: (N, 3) centre line, metres, base frame.
        surface: (M, 3) surface points, metres, base frame.
        normals: (M, 3) outward unit normals.
        r: Radius of the string, metres.

    Returns:
        (K, 3) centre line from the end of the string, metres, base frame. The line is unchanged if fewer than
        `MIN_END_POINTS` surface points lie around the parabola, or if fewer than three line points would remain.
    """
    terms = fit_end_parabola(line, END_FIT_RADII * r, r)
    seen = _surface_along(terms, surface, normals, -2 * r, MAX_EXTENSION_RADII * r, r)
    if len(seen) < MIN_END_POINTS or float(np.median(np.diff(arc_length(line)))) <= 0:
        return line
    return move_end(line, terms, _last_without_hole(seen, r), r)


def extend_below_strand(line: Points, surface: Points, normals: Points, others: Points, r: float) -> Points:
    """Extend a centre line at its first point to a short end that it has beyond a strand above it.

    The surface of a string has a hole where another strand covers the string. The part beyond the hole is traced as a
    fragment of its own if it is long enough to have a direction. This function finds a shorter part.

    Args:
        line: (N, 3) centre line, metres, base frame.
        surface: (M, 3) surface points that lie on no other strand, metres, base frame.
        normals: (M, 3) outward unit normals.
        others: (K, 3) points of the centre lines of the other strands, metres, base frame.
        r: Radius of the string, metres.

    Returns:
        (L, 3) centre line from the end of the string, metres, base frame. The line is unchanged if no strand covers its
        extension, or if fewer than `MIN_END_POINTS` surface points lie around the extension beyond that strand.
    """
    terms = fit_end_parabola(line, END_FIT_RADII * r, r)
    direction = -terms[1] / max(float(np.linalg.norm(terms[1])), 1e-12)
    s = np.arange(0.0, MAX_COVER_RADII, 0.25) * r
    ahead = terms[0] + s[:, None] * direction
    near = others[np.linalg.norm(others - terms[0], axis=1) < (MAX_COVER_RADII + 2) * r]
    above = near[near[:, 2] > terms[0, 2] + MIN_ABOVE_RADII * r]
    if len(above) == 0:
        return line
    covered = np.flatnonzero(KDTree(above[:, :2]).query(ahead[:, :2])[0] < r)
    if len(covered) == 0 or s[covered[0]] > MAX_AHEAD_RADII * r:
        return line
    # The covered part ends before the first index that is missing.
    first_gaps = np.flatnonzero(np.diff(covered) > 1)
    edge = float(s[covered[first_gaps[0] if len(first_gaps) else -1]])
    seen = _surface_along(terms, surface, normals, edge - r, edge + MAX_EXTENSION_RADII * r, r)
    if len(seen) < MIN_END_POINTS or seen[0] > edge + MAX_HOLE_RADII * r:
        return line
    return move_end(line, terms, _last_without_hole(seen, r), r)


def _surface_along(terms: Points, surface: Points, normals: Points, first: float, last: float, r: float) -> Points:
    """Return the sorted positions (K,) along a parabola of the surface around it, between two positions, metres."""
    direction = -terms[1] / max(float(np.linalg.norm(terms[1])), 1e-12)
    is_near = np.linalg.norm(surface - terms[0], axis=1) < max(-first, last) + 2 * r
    offset, normal = surface[is_near] - terms[0], normals[is_near]
    along = offset @ direction
    # The bend is fitted to a short part of the line. Beyond r, its displacement stays constant.
    bend = terms[2] - (terms[2] @ direction) * direction
    across = offset - along[:, None] * direction - bend * np.minimum(along, r)[:, None] ** 2
    distance = np.linalg.norm(across, axis=1)
    is_around = (distance > 0.6 * r) & (distance < 1.35 * r) & ((across * normal).sum(axis=1) > 0.6 * distance)
    return np.sort(along[is_around & (along > first) & (along < last)])


def _last_without_hole(seen: Points, r: float) -> float:
    """Return the position of the end, metres: the last of the sorted positions `seen` (K,) before a hole."""
    holes = np.flatnonzero(np.diff(seen) > MAX_HOLE_RADII * r)
    if len(holes):
        seen = seen[: holes[0] + 1]
    last = seen[seen > seen[-1] - 2 * r]
    return float(np.percentile(last, EDGE_PERCENTILE))


def move_end(line: Points, terms: Points, end: float, r: float) -> Points:
    """Extend or shorten a centre line at its first point. The spacing of the points stays about the same.

    Args:
        line: (N, 3) centre line, metres.
        terms: (3, 3) parabola through the first part of the line, as `fit_end_parabola` returns it.
        end: Distance of the new end beyond the first point, metres; negative shortens the line.
        r: Radius of the string, metres.

    Returns:
        (K, 3) centre line from the new end. The line is unchanged if fewer than three points would remain.
    """
    s = arc_length(line)
    spacing = float(np.median(np.diff(s)))
    kept = line[s > max(-end, 0.0) + 0.5 * spacing]
    # The added points lie on the parabola in even steps, from the end of the string to the first kept point.
    count = max(int(np.ceil((s[len(line) - len(kept)] + end) / spacing - 0.5)), 1) if len(kept) else 1
    added_s = -end + spacing * np.arange(count)
    added = terms[0] + added_s[:, None] * terms[1] + np.maximum(added_s, -r)[:, None] ** 2 * terms[2]
    moved = np.vstack([added, kept])
    # Keep the line if too few points would remain. The string classifier excludes lines that are too short.
    return moved if len(moved) > 2 else line
