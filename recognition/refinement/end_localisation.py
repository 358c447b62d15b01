"""Localisation of the end of a string: the farthest surface around the extrapolated centre line."""

from dataclasses import dataclass

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
COVER_STEP_RADII = 0.25
"""Distance between the examined positions along an extrapolated line, in radii of the string."""
AROUND_RADII = (0.6, 1.35)
"""Range of the distances from the extrapolated line of surface around it, in radii of the string."""
MIN_AROUND_COSINE = 0.6
"""Minimum cosine between the normal of surface around the extrapolated line and the direction from the line to it."""
NEAR_MARGIN_RADII = 2.0
"""Margin of the preselection of points near an extrapolated line, in radii: more than `AROUND_RADII`, and the bend."""
LAST_SURFACE_RADII = 2.0
"""Length of the last part of the surface, from which `EDGE_PERCENTILE` is taken, in radii of the string."""


@dataclass(frozen=True, eq=False)
class EndCurve:
    """Parabola `origin + s * slope + s**2 * bend` through the first part of a centre line, by its arc length s."""

    origin: Points
    """(3,) position of the end, metres, base frame."""
    slope: Points
    """(3,) direction into the line. Its length is about 1, or 0 if all points coincide."""
    bend: Points
    """(3,) half of the curvature, 1/m; zero for a short line."""
    r: float
    """Radius of the string, metres."""

    @classmethod
    def fit(cls, line: Points, r: float) -> "EndCurve":
        """Fit the parabola to the first `END_FIT_RADII` radii of a line (N, 3) of a string with the radius r."""
        origin, slope, bend = fit_end_parabola(line, END_FIT_RADII * r, r)
        return cls(origin, slope, bend, r)

    @property
    def outward(self) -> Points:
        """(3,) unit vector out of the line; zero if all points coincide."""
        return -self.slope / max(float(np.linalg.norm(self.slope)), 1e-12)


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
    curve = EndCurve.fit(line, r)
    seen = _surface_along(curve, surface, normals, -LAST_SURFACE_RADII * r, MAX_EXTENSION_RADII * r)
    if len(seen) < MIN_END_POINTS or float(np.median(np.diff(arc_length(line)))) <= 0:
        return line
    return move_end(line, curve, _last_without_hole(seen, r))


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
    curve = EndCurve.fit(line, r)
    s = np.arange(0.0, MAX_COVER_RADII, COVER_STEP_RADII) * r
    ahead = curve.origin + s[:, None] * curve.outward
    near = others[np.linalg.norm(others - curve.origin, axis=1) < (MAX_COVER_RADII + NEAR_MARGIN_RADII) * r]
    above = near[near[:, 2] > curve.origin[2] + MIN_ABOVE_RADII * r]
    if len(above) == 0:
        return line
    distance, _ = KDTree(above[:, :2]).query(ahead[:, :2])
    covered = np.flatnonzero(distance < r)
    if len(covered) == 0 or s[covered[0]] > MAX_AHEAD_RADII * r:
        return line
    # Only the first run of successive covered positions lies below that strand.
    first_run = np.split(covered, np.flatnonzero(np.diff(covered) > 1) + 1)[0]
    edge = float(s[first_run[-1]])
    seen = _surface_along(curve, surface, normals, edge - r, edge + MAX_EXTENSION_RADII * r)
    if len(seen) < MIN_END_POINTS or seen[0] > edge + MAX_HOLE_RADII * r:
        return line
    return move_end(line, curve, _last_without_hole(seen, r))


def _surface_along(curve: EndCurve, surface: Points, normals: Points, first: float, last: float) -> Points:
    """Return the sorted positions (K,) along a parabola of the surface around it, between two positions, metres.

    Positions beyond the end of the line are positive.
    """
    r = curve.r
    outward = curve.outward
    is_near = np.linalg.norm(surface - curve.origin, axis=1) < max(-first, last) + NEAR_MARGIN_RADII * r
    offset = surface[is_near] - curve.origin
    along = offset @ outward
    # The bend is fitted to a short part of the line. Beyond r, its displacement stays constant.
    bend = curve.bend - (curve.bend @ outward) * outward
    across = offset - along[:, None] * outward - bend * np.minimum(along, r)[:, None] ** 2
    distance = np.linalg.norm(across, axis=1)
    min_distance, max_distance = (radii * r for radii in AROUND_RADII)
    is_around = (distance > min_distance) & (distance < max_distance)
    is_around &= (across * normals[is_near]).sum(axis=1) > MIN_AROUND_COSINE * distance
    return np.sort(along[is_around & (along > first) & (along < last)])


def _last_without_hole(seen: Points, r: float) -> float:
    """Return the position of the end, metres: the last of the sorted positions `seen` (K,) before a hole."""
    holes = np.flatnonzero(np.diff(seen) > MAX_HOLE_RADII * r)
    if len(holes):
        seen = seen[: holes[0] + 1]
    last = seen[seen > seen[-1] - LAST_SURFACE_RADII * r]
    return float(np.percentile(last, EDGE_PERCENTILE))


def move_end(line: Points, curve: EndCurve, end: float) -> Points:
    """Extend or shorten a centre line at its first point. The spacing of the points stays about the same.

    Args:
        line: (N, 3) centre line, metres.
        curve: Parabola through the first part of the line.
        end: Distance of the new end beyond the first point, metres; negative shortens the line.

    Returns:
        (K, 3) centre line from the new end. The line is unchanged if fewer than three points would remain.
    """
    s = arc_length(line)
    spacing = float(np.median(np.diff(s)))
    kept = line[s > max(-end, 0.0) + 0.5 * spacing]
    # The added points lie on the parabola in even steps, from the end of the string to the first kept point.
    count = 1
    if len(kept):
        to_first_kept = s[len(line) - len(kept)] + end
        count = max(int(np.ceil(to_first_kept / spacing - 0.5)), 1)
    added_s = -end + spacing * np.arange(count)
    # Beyond r, the displacement by the bend stays constant, as in `_surface_along`.
    bend_s = np.maximum(added_s, -curve.r)
    added = curve.origin + added_s[:, None] * curve.slope + bend_s[:, None] ** 2 * curve.bend
    moved = np.vstack([added, kept])
    # Keep the line if too few points would remain. The string classifier excludes lines that are too short.
    return moved if len(moved) > 2 else line
