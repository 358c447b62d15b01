"""Classification of fitted strands: strings, or edges of objects, folds and noise."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from recognition.geometry.polyline import arc_length, close_polyline
from recognition.messages import format_position
from recognition.model.chains import canonical_order
from recognition.parameters import ChainParameters
from recognition.refinement.refinement import FittedStrand, Refinement

MIN_LENGTH_RADII = 10.0
"""Minimum length of a string, in radii.

A shorter piece is less than five times as long as thick. Edges and crumbs give such pieces.
"""
MIN_ON_TUBE_SHARE = 0.75
"""Minimum share of the surface beside a string that lies on its tube.

It is about 0.9 for strings, and about half beside an edge of a box, whose faces go on.
"""
MAX_BESIDE_RADII = 2.2
"""Distance from the centre line within which surface is beside a strand, in radii of the strand.

If the expected r is larger than its radius, the distance is in r.
"""
MAX_OUT_OF_ROUND_SHARE = 0.04
"""Maximum standard deviation of a string's profile from a circle, as a share of its radius.

If the expected r is larger than its radius, the share is of r.

Strings had up to 0.03 in simulated scans and scans from other sources. Edges of boxes had 0.05 and more, and so had
bars seen from near.
"""
MAX_SQUARENESS = 0.25
"""Maximum squareness of a string (0: round, 1: square bar).

Depth noise of a fifth of the radius leaves about half of a bar's profile. Strings of 0.1 m and more had up to 0.15.
"""
UNCERTAIN_SIGMAS = 2.0
"""Number of sigmas by which a measured squareness may be wrong.

A strand is excluded as a bar only if its squareness exceeds this number of sigmas. A kept strand is reported as
ambiguous if its squareness would exceed `MAX_SQUARENESS` with this number of sigmas added.
"""
MIN_HEIGHT_SHARE = 0.6
"""Minimum height of the centre line above the table, as a share of the strand's radius.

The centre line of a string is at least its radius above the table. A lower line belongs to something else, like the
edge of a leaning plate.
"""
HEIGHT_PERCENTILE = 15.0
"""Percentile of the heights of the centre line that must reach `MIN_HEIGHT_SHARE`. Ends are known worst."""
MIN_AMBIGUOUS_LENGTH_RADII = 40.0
"""A poorly supported piece of at least this length, in radii, may still be a string."""
MIN_SUPPORTED_SHARE = 0.5
"""Minimum share of a strand's points that have the support of `MIN_SUPPORT_SHARE`."""
MIN_SUPPORT_SHARE = 0.25
"""Support of a well-supported point, as a share of the median support of the longest string."""


@dataclass(frozen=True, eq=False)
class StringClassification:
    """The strands that are strings, and the messages about the others."""

    strings: tuple[FittedStrand, ...]
    """Strings in the order and direction of the model: the longest comes first."""
    ambiguities: tuple[str, ...]
    """One message for each excluded strand that may be a string."""
    warnings: tuple[str, ...]
    """One message for each other excluded strand."""


def classify_strings(
    refinement: Refinement, surface: NDArray[np.float64], parameters: ChainParameters, table_z_m: float = 0.0
) -> StringClassification:
    """Return the fitted strands that are strings.

    A string is round: the surface beside it lies on its tube and has no flat top with edges. It lies on the table, not
    in it. It is long enough, and the surface supports most of it.

    Args:
        refinement: Fitted strands and the strand of each surface point.
        surface: (M, 3) registered surface points, metres, base frame.
        parameters: Radius r.
        table_z_m: Height of the table, metres.

    Returns:
        The strings, and the messages about excluded strands, longest first.

    Source:
        Ours.
    """
    strands = refinement.strands
    on_tube_shares = _on_tube_shares(refinement, surface, parameters.r)
    kept: list[int] = []
    ambiguities, warnings = [], []
    lengths = [float(arc_length(close_polyline(strand.points, strand.closed))[-1]) for strand in strands]
    for k in np.argsort(-np.array(lengths), kind="stable").tolist():
        strand, length = strands[k], lengths[k]
        usual_support = float(np.median(strands[kept[0]].support)) if kept else 0.0
        is_supported = bool(np.mean(strand.support >= MIN_SUPPORT_SHARE * usual_support) >= MIN_SUPPORTED_SHARE)
        is_round = _is_round(strand, parameters.r) and on_tube_shares[k] >= MIN_ON_TUBE_SHARE
        if length < MIN_LENGTH_RADII * parameters.r:
            reason = "too short to be distinguished from noise"
        elif not is_supported:
            reason = "hardly seen"
        elif not is_round:
            reason = "not round like a string"
        elif _is_in_table(strand, table_z_m):
            reason = "its tube would reach into the table"
        else:
            kept.append(k)
            continue
        message = (
            f"excluded a piece of {length * 1000:.0f} mm at {format_position(strand.points.mean(axis=0))}: {reason}"
        )
        if length >= MIN_AMBIGUOUS_LENGTH_RADII * parameters.r and not is_supported:
            ambiguities.append(f"{message}, so it may be a string")
        else:
            warnings.append(message)
    return StringClassification(tuple(_orient(strands[k]) for k in kept), tuple(ambiguities), tuple(warnings))


def may_be_square(strand: FittedStrand) -> bool:
    """Return whether the surface of a string is too uncertain to exclude that it is a square bar."""
    return strand.squareness + UNCERTAIN_SIGMAS * strand.squareness_sigma > MAX_SQUARENESS


def _is_round(strand: FittedStrand, r: float) -> bool:
    is_circular = strand.out_of_round_m <= MAX_OUT_OF_ROUND_SHARE * max(strand.radius_m, r)
    is_square = strand.squareness > max(MAX_SQUARENESS, UNCERTAIN_SIGMAS * strand.squareness_sigma)
    return is_circular and not is_square


def _is_in_table(strand: FittedStrand, table_z_m: float) -> bool:
    height = float(np.percentile(strand.points[:, 2], HEIGHT_PERCENTILE)) - table_z_m
    return height < MIN_HEIGHT_SHARE * strand.radius_m


def _on_tube_shares(refinement: Refinement, surface: NDArray[np.float64], r: float) -> NDArray[np.float64]:
    """Return (K,) the share of the surface beside each strand, and nearer to no other, that lies on its tube."""
    strands = refinement.strands
    if not strands:
        return np.empty(0)
    strand_of_point = np.repeat(np.arange(len(strands)), [len(strand.points) for strand in strands])
    radii = np.array([max(strand.radius_m, r) for strand in strands])
    distance, indices = KDTree(np.vstack([strand.points for strand in strands])).query(surface)
    nearest = strand_of_point[np.asarray(indices)]
    is_beside = np.asarray(distance) < MAX_BESIDE_RADII * radii[nearest]
    nearest, owner = nearest[is_beside], refinement.owner[is_beside]
    count = np.bincount(nearest, minlength=len(strands))
    return np.bincount(nearest, owner == nearest, len(strands)) / np.maximum(count, 1)


def _orient(strand: FittedStrand) -> FittedStrand:
    """Return the strand with its points in the order of the model."""
    order = canonical_order(strand.points, strand.closed)
    return replace(strand, points=strand.points[order], bridged=strand.bridged[order], support=strand.support[order])
