"""Where two strands have melted together, a line that runs between them is neither's."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d
from scipy.spatial import KDTree

from recognition.geometry.polyline import arc_length, close_polyline, points_at, resampled_lengths
from recognition.parameters import ChainParameters
from recognition.tracing.fragments import Fragment

LINE_SHARE = 0.35
"""Step, as a share of r, in which the fragments' lines are looked at."""
OFF_SHARE = 1.3
"""Surface farther from a line than this, as a share of r, is not of its strand."""
BESIDE_SHARE = 2.2
"""... and nearer than this it lies beside it."""
HIGH_SHARE = 0.2
"""Of a strand below, less is seen beside a line than this share of r above it."""
LEAST_ASIDE = 0.09
"""Share of the surface above a line, that is not of its strand, on each side of it, from which on the line runs
between two strands. Strands by themselves and at crossings have up to 0.07, in clear cases it is 0.1 to 0.15."""
SMOOTHED = 5
"""Steps of the line over which the shares are taken."""


def split_merged_strands(
    fragments: Sequence[Fragment], surface: NDArray[np.float64], parameters: ChainParameters
) -> list[Fragment]:
    """The fragments without the places at which they run between two strands of the `surface` (M, 3).

    Where strands cross twice nearby, each over the other once, they lie side by side at one height in between. If
    they are soft, and nearer than 2 r there, what is seen is one ridge, and links lead from the one strand to the
    other. Such a ridge is wider than a string, to both sides of the line. Without it, all four ends are there to be
    paired.
    """
    aside = _aside(fragments, surface, parameters.r)
    parts = []
    for fragment, share in zip(fragments, aside, strict=True):
        kept = share < LEAST_ASIDE
        # All along, it is a string thicker than told.
        if np.median(share) >= LEAST_ASIDE / 2:
            kept[:] = True
        parts += fragment.pieces(kept, np.zeros(len(kept), dtype=bool))
    return parts


def _aside(fragments: Sequence[Fragment], surface: NDArray[np.float64], r: float) -> list[NDArray[np.float64]]:
    """For each fragment (N,), at its points, the share of the surface about it that is aside on both sides."""
    if not fragments:
        return []
    whole = [close_polyline(fragment.points, fragment.closed) for fragment in fragments]
    lengths = [resampled_lengths(line, LINE_SHARE * r) for line in whole]
    lines = [points_at(line, s) for line, s in zip(whole, lengths, strict=True)]
    points = np.vstack(lines)
    way = np.vstack([np.gradient(line[:, :2], axis=0) for line in lines])
    way /= np.maximum(np.linalg.norm(way, axis=1, keepdims=True), 1e-12)
    distance, found = KDTree(points).query(surface, distance_upper_bound=BESIDE_SHARE * r)
    about = np.isfinite(distance)
    nearest, off = np.asarray(found)[about], np.asarray(distance)[about] > OFF_SHARE * r
    offset = surface[about] - points[nearest]
    left = offset[:, 1] * way[nearest, 0] - offset[:, 0] * way[nearest, 1]
    high = offset[:, 2] > HIGH_SHARE * r
    counts = [
        np.bincount(nearest[chosen], minlength=len(points)).astype(np.float64)
        for chosen in (high, high & off & (left > r), high & off & (left < -r))
    ]
    shares = []
    first = 0
    for fragment, line, at in zip(fragments, lines, lengths, strict=True):
        total, one, other = (
            uniform_filter1d(count[first : first + len(line)], SMOOTHED, mode="constant") for count in counts
        )
        first += len(line)
        share = np.minimum(one, other) / np.maximum(total, 1 / SMOOTHED)
        shares.append(np.interp(arc_length(fragment.points), at, share))
    return shares
