"""Localisation of a string's end: the farthest surface about the extrapolated centre line."""

import numpy as np
from numpy.typing import NDArray

from recognition.geometry.polyline import arc_length, fit_end_parabola

Points = NDArray[np.float64]

END_FIT_RADII = 4.0
"""Length of string, in radii, from which an end is extrapolated."""
MAX_EXTENSION_RADII = 3.0
"""Maximum length by which a line is extended, in radii."""
EDGE_PERCENTILE = 95.0
"""Percentile of the surface along the last 2 r of the axis that is taken for the end. The rest is depth noise.

Measured on simulated scans and scans from other sources: within half a millimetre of the true end, without a bias.
"""
MAX_HOLE_RADII = 0.5
"""A hole in the surface along the axis that is longer than this, in radii, is the end of the string.

The surface after it belongs to another object.
"""
MIN_END_POINTS = 5
"""Minimum number of surface points about the end. With fewer, the line is not changed."""


def localise_end(line: Points, surface: Points, normals: Points, r: float) -> Points:
    """Return the line with its first point moved to the end of the string.

    The line is extrapolated by the parabola through its last 4 r, as far as there is surface about it at its radius.
    Points are added or removed. The spacing stays about the same.

    Args:
        line: (N, 3) centre line, metres, base frame.
        surface: (M, 3) surface points, metres, base frame.
        normals: (M, 3) outward unit normals.
        r: Radius of the string, metres.

    Returns:
        (K, 3) the line from its end, metres, base frame. It is not changed if there is hardly any surface about its
        end, or if fewer than three points would be left.

    Source:
        Ours.
    """
    s = arc_length(line)
    terms = fit_end_parabola(line, END_FIT_RADII * r, r)
    direction = -terms[1] / max(float(np.linalg.norm(terms[1])), 1e-12)
    is_near = np.linalg.norm(surface - terms[0], axis=1) < (MAX_EXTENSION_RADII + 2) * r
    offset, normal = surface[is_near] - terms[0], normals[is_near]
    along = offset @ direction
    # The bend is known from about a centimetre of string only, so it is not extrapolated by more than r.
    bend = terms[2] - (terms[2] @ direction) * direction
    across = offset - along[:, None] * direction - bend * np.minimum(along, r)[:, None] ** 2
    distance = np.linalg.norm(across, axis=1)
    is_around = (distance > 0.6 * r) & (distance < 1.35 * r) & ((across * normal).sum(axis=1) > 0.6 * distance)
    seen = np.sort(along[is_around & (along > -2 * r) & (along < MAX_EXTENSION_RADII * r)])
    spacing = float(np.median(np.diff(s)))
    if len(seen) < MIN_END_POINTS or spacing <= 0:
        return line
    holes = np.flatnonzero(np.diff(seen) > MAX_HOLE_RADII * r)
    if len(holes):
        seen = seen[: holes[0] + 1]
    last = seen[seen > seen[-1] - 2 * r]
    end = float(np.percentile(last, EDGE_PERCENTILE))
    kept = line[s > max(-end, 0.0) + 0.5 * spacing]
    # The added points lead from the end, along the parabola, to the first point that is kept, in even steps.
    count = max(int(np.ceil((s[len(line) - len(kept)] + end) / spacing - 0.5)), 1) if len(kept) else 1
    added_s = -end + spacing * np.arange(count)
    added = terms[0] + added_s[:, None] * terms[1] + np.maximum(added_s, -r)[:, None] ** 2 * terms[2]
    moved = np.vstack([added, kept])
    # A line without length is not a string. The string classifier decides that, not this function.
    return moved if len(moved) > 2 else line
