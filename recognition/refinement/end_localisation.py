"""Where a string really ends: the farthest surface that lies about the continued centre line."""

import numpy as np
from numpy.typing import NDArray

from recognition.geometry.parabola import fit_end_parabola
from recognition.geometry.polyline import arc_length

LOOKED_AT = 4.0
"""Length of string, in radii, from which an end is continued."""
FARTHEST = 3.0
"""How far ahead, in radii, a line may be continued."""
EDGE_PERCENTILE = 95.0
"""Of the surface's places along the last 2 r of the axis, the one taken for the end: the rest is depth noise.
Measured on simulated and foreign scans: within half a millimetre of the true end, without a bias."""
WIDEST_HOLE = 0.5
"""A hole in the surface along the axis longer than this, in radii, is the end: what follows is another thing."""

Points = NDArray[np.float64]


def localise_end(line: Points, surface: Points, normals: Points, r: float) -> Points:
    """`line` (N, 3) with its first point moved to the string's end, points added or taken away as needed.

    The line is continued by the parabola through its last 4 r, and goes as far as surface (M, 3) with normals
    (M, 3) lies about it at its radius. Points near the old end are disturbed by what lies beside it and count less.
    The spacing stays about the same.
    """
    s = arc_length(line)
    terms = fit_end_parabola(line, LOOKED_AT * r, r)
    direction = -terms[1] / max(float(np.linalg.norm(terms[1])), 1e-12)
    # Bends are known from the string's last centimetre only: they are not carried on for more than r.
    near = np.linalg.norm(surface - terms[0], axis=1) < (FARTHEST + 2) * r
    offset, normal = surface[near] - terms[0], normals[near]
    along = offset @ direction
    bend = terms[2] - (terms[2] @ direction) * direction
    across = offset - along[:, None] * direction - bend * np.minimum(along, r)[:, None] ** 2
    distance = np.linalg.norm(across, axis=1)
    around = (distance > 0.6 * r) & (distance < 1.35 * r) & ((across * normal).sum(axis=1) > 0.6 * distance)
    places = np.sort(along[around & (along > -2 * r) & (along < FARTHEST * r)])
    spacing = float(np.median(np.diff(s)))
    if len(places) < 5 or spacing <= 0:
        return line
    holes = np.flatnonzero(np.diff(places) > WIDEST_HOLE * r)
    if len(holes):
        places = places[: holes[0] + 1]
    last = places[places > places[-1] - 2 * r]
    reach = float(np.percentile(last, EDGE_PERCENTILE))
    kept = line[s > max(-reach, 0.0) + 0.5 * spacing]
    # From the parabola's place at the end to the first point kept, in even steps.
    count = max(int(np.ceil((s[len(line) - len(kept)] + reach) / spacing - 0.5)), 1) if len(kept) else 1
    at = -reach + spacing * np.arange(count)
    added = terms[0] + at[:, None] * terms[1] + np.maximum(at, -r)[:, None] ** 2 * terms[2]
    moved = np.vstack([added, kept])
    # What has no length left is no string's line: it is for others to say so.
    return moved if len(moved) > 2 else line
