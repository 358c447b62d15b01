"""Splitting of fragments that run between two strands, where the two strands are merged in the data.

Foreign surface lies beside the line of a fragment, but too far away to belong to the strand of the fragment.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d
from scipy.spatial import KDTree

from recognition.geometry.polyline import arc_length, close_polyline, points_at, resampled_lengths, unit_vectors
from recognition.parameters import ChainParameters
from recognition.preprocessing.plane_fit import SIGMA_PER_MAD
from recognition.tracing.fragments import Fragment

STEP_RADII = 0.35
"""Spacing of the points along a fragment at which the surface is examined, in radii r."""
MAX_OWN_RADII = 1.3
"""Maximum distance between a line and the surface of its own strand, in radii r. Farther surface is foreign."""
MAX_BESIDE_RADII = 2.2
"""Maximum distance between a line and the examined surface, in radii r."""
MIN_HEIGHT_RADII = 0.2
"""Minimum height of the examined surface above the line, in radii r. It excludes most surface of lower strands."""
MIN_MERGED_SHARE = 0.09
"""Minimum share of foreign surface on each side of a line that runs between two strands.

Single strands and crossings have up to 0.07. Clear cases of merged strands have 0.1 to 0.15.
"""
SCENE_SIGMAS = 3.0
"""The same share in standard deviations above the median of the scene, if that is more.

Matching windows of a stereo camera widen all strings, unevenly. Most of a scene consists of single strands.
"""
SMOOTHING_STEPS = 5
"""Number of points along the line over which the counts of surface points are averaged."""


def split_merged_strands(
    fragments: Sequence[Fragment], surface: NDArray[np.float64], parameters: ChainParameters
) -> list[Fragment]:
    """Remove the parts of the fragments that run between two strands.

    Two strands may cross twice within a short distance and exchange over and under. Between the crossings they lie side
    by side at the same height. If the strands are soft and closer than 2 r, they form a single ridge, and links lead
    from one strand to the other. At such a ridge, the surface is wider than a string on both sides of the fragment.
    Fragments are cut at the ridge, so that the four ends can be paired.

    Args:
        fragments: Fragments of the scene.
        surface: (M, 3) registered surface points, metres, base frame.
        parameters: Method parameters; uses the radius r.

    Returns:
        The remaining parts of the fragments. A fragment that is wide along most of its length is not cut, because its
        string is thicker than r.
    """
    shares = _foreign_shares(fragments, surface, parameters.r)
    min_share = _min_merged_share(shares)
    parts = []
    for fragment, share in zip(fragments, shares, strict=True):
        keep = share < min_share
        # Do not cut a fragment that is wide along most of its length: its string is thicker than r.
        if np.median(share) >= min_share / 2:
            keep[:] = True
        parts += fragment.split(keep, np.zeros(len(keep), dtype=bool))
    return parts


def _min_merged_share(shares: Sequence[NDArray[np.float64]]) -> float:
    """Return the minimum share of foreign surface of merged strands, given the shares (N,) of all fragments."""
    if not shares:
        return MIN_MERGED_SHARE
    of_scene = np.concatenate(shares)
    median = float(np.median(of_scene))
    sigma = SIGMA_PER_MAD * float(np.median(np.abs(of_scene - median)))
    return max(MIN_MERGED_SHARE, median + SCENE_SIGMAS * sigma)


def _foreign_shares(fragments: Sequence[Fragment], surface: NDArray[np.float64], r: float) -> list[NDArray[np.float64]]:
    """Return the shares (N,) of foreign surface at the points of each fragment, 0 to 1.

    The share is computed for the left and the right side of the line. The smaller of the two values is returned.
    """
    if not fragments:
        return []
    closed_lines = [close_polyline(fragment.points, fragment.closed) for fragment in fragments]
    lengths = [resampled_lengths(line, STEP_RADII * r) for line in closed_lines]
    lines = [points_at(line, s) for line, s in zip(closed_lines, lengths, strict=True)]
    points = np.vstack(lines)
    tangent = unit_vectors(np.vstack([np.gradient(line[:, :2], axis=0) for line in lines]))
    distance, indices = KDTree(points).query(surface, distance_upper_bound=MAX_BESIDE_RADII * r)
    is_beside = np.isfinite(distance)
    nearest = np.asarray(indices)[is_beside]
    is_foreign = np.asarray(distance)[is_beside] > MAX_OWN_RADII * r
    offset = surface[is_beside] - points[nearest]
    left = offset[:, 1] * tangent[nearest, 0] - offset[:, 0] * tangent[nearest, 1]
    is_high = offset[:, 2] > MIN_HEIGHT_RADII * r
    is_left = is_high & is_foreign & (left > r)
    is_right = is_high & is_foreign & (left < -r)
    counts = [
        np.bincount(nearest[selected], minlength=len(points)).astype(np.float64)
        for selected in (is_high, is_left, is_right)
    ]
    shares = []
    first = 0
    for fragment, line, s in zip(fragments, lines, lengths, strict=True):
        own = slice(first, first + len(line))
        first += len(line)
        total, on_left, on_right = (uniform_filter1d(count[own], SMOOTHING_STEPS, mode="constant") for count in counts)
        share = np.minimum(on_left, on_right) / np.maximum(total, 1 / SMOOTHING_STEPS)
        shares.append(np.interp(arc_length(fragment.points), s, share))
    return shares
