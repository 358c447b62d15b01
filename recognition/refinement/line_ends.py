"""Ends of all centre lines of a scene: localise each of them in the surface, and then in the depth images."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from recognition.geometry.polyline import arc_length
from recognition.preprocessing.normals import NormalCloud
from recognition.refinement.end_in_images import (
    OWN_END_RADII,
    localise_end_in_images,
    other_strand_points,
    other_strand_tree,
)
from recognition.refinement.end_localisation import MAX_EXTENSION_RADII, extend_below_strand, localise_end
from recognition.refinement.tube_fit import TubeFit
from recognition.strand import Strand

Points = NDArray[np.float64]


def localise_line_ends(strands: Sequence[Strand], fit: TubeFit) -> list[Points]:
    """Move the two ends of each open line to where its surface ends. Closed lines are unchanged.

    Args:
        strands: Strand of each line.
        fit: Lines and radii, and the surface. They are not changed.

    Returns:
        (N_k, 3) points of each line, metres, base frame.
    """
    lines = fit.lines
    radii = fit.radii
    open_lines = [k for k, strand in enumerate(strands) if not strand.closed]
    # Link of each surface point; -1 for surface on no strand.
    link = np.full(len(fit.surface), -1)
    # A single line that stays away from its own ends needs no assignment: all surface shows its ends.
    if len(lines) > 1 or any(_is_near_own_end(lines[k], radii[k]) for k in open_lines):
        assigned = fit.assign()
        link[assigned.point] = assigned.link
    localised = list(lines)
    for k in open_lines:
        s = arc_length(lines[k])
        for from_end in (s, s[-1] - s):
            # Surface on other strands, and on this strand away from the end, does not show the end.
            is_own_link = np.zeros(len(fit.points) + 1, dtype=bool)
            is_own_link[fit.rows(k)] = from_end <= OWN_END_RADII * radii[k]
            is_own_link[-1] = True  # link -1: surface on no strand
            is_own = is_own_link[link]
            own_points = fit.surface[is_own]
            own_normals = fit.normals[is_own]
            line = localise_end(localised[k], own_points, own_normals, radii[k])
            others = other_strand_points([*lines[:k], line, *lines[k + 1 :]], k, radii[k])
            # Each pass treats the first point and turns the line round.
            localised[k] = extend_below_strand(line, own_points, own_normals, others, radii[k])[::-1]
    return localised


def localise_line_ends_in_images(
    strands: Sequence[Strand],
    lines: Sequence[Points],
    radii: NDArray[np.float64],
    views: Sequence[NormalCloud],
    other_lines: Sequence[Points],
    border_offset_m: float,
) -> list[Points]:
    """Move the two ends of each open line to where the depth images show them. Closed lines are unchanged.

    Args:
        strands: Strand of each line.
        lines: (N_k, 3) points of each line, metres, base frame.
        radii: (K,) radius of each line, metres.
        views: Registered views with their depth images.
        other_lines: Centre lines of other strings, metres, base frame. Their pixels do not show the ends.
        border_offset_m: Distance by which the images show sides of strings outside their tubes, metres.

    Returns:
        (N_k, 3) points of each line, metres, base frame.
    """
    localised = list(lines)
    for k, strand in enumerate(strands):
        if strand.closed:
            continue
        for _ in range(2):
            others = other_strand_tree([*localised, *other_lines], k, radii[k])
            # Each pass treats the first point and turns the line round.
            localised[k] = localise_end_in_images(localised[k], views, others, radii[k], border_offset_m)[::-1]
    return localised


def _is_near_own_end(line: Points, r: float) -> bool:
    """Return whether a line comes near one of its two ends again."""
    for from_end in (line, line[::-1]):
        rest = from_end[arc_length(from_end) > OWN_END_RADII * r]
        distance = np.linalg.norm(rest - from_end[0], axis=1)
        if (distance < 2 * MAX_EXTENSION_RADII * r).any():
            return True
    return False
