"""Classification of fitted strands: separates strings from edges of objects, folds and noise."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from recognition.excluded_pieces import excluded_piece, shortened
from recognition.geometry.polyline import arc_length, close_polyline
from recognition.model.canonical_order import canonical_line, order_key
from recognition.model.finding_types import FindingCode
from recognition.model.findings import Finding
from recognition.parameters import ChainParameters
from recognition.preprocessing.support_surface import SupportSurface
from recognition.refinement.refinement import FittedStrand, Refinement

MIN_LENGTH_RADII = 10.0
"""Minimum length of a string, in radii r.

A shorter strand is less than five times as long as thick. Edges and crumbs give strands of this length.
"""
MIN_ON_TUBE_SHARE = 0.75
"""Minimum share of the surface points beside a string that lie on its tube.

The share is about 0.9 for strings. It is about 0.5 for the edge of a box, because the faces of the box continue.
"""
MAX_BESIDE_RADII = 2.2
"""Maximum distance from the centre line at which surface lies beside a strand.

The unit is the radius of the strand, or the expected r if r is larger.
"""
MAX_ROUNDNESS_ERROR = 0.04
"""Maximum standard deviation of a string's profile from a circle, as a share of the radius.

The radius is the radius of the strand, or the expected r if r is larger. In simulated scans and scans from other
sources, strings had up to 0.03. Edges of boxes and near bars had 0.05 and more.
"""
MAX_SQUARENESS = 0.25
"""Maximum squareness of a string (0: round, 1: square bar).

With a depth noise of a fifth of the radius, a square bar has a squareness of about 0.5. Strings of 0.1 m and more had
up to 0.15.
"""
UNCERTAIN_SIGMAS = 2.0
"""Assumed maximum error of a measured squareness, in sigmas.

A strand is excluded as a bar only if its squareness exceeds this number of sigmas. A string is a possible bar if its
squareness plus this number of sigmas exceeds `MAX_SQUARENESS`.
"""
MIN_HEIGHT_SHARE = 0.6
"""Minimum height of a string's centre line above the table, as a share of the radius of the strand.

The centre line of a string is at least one radius above the table. A lower line belongs to another object, for example
the edge of a leaning plate.
"""
HEIGHT_PERCENTILE = 15.0
"""Percentile of the centre line heights that must reach `MIN_HEIGHT_SHARE`. Heights at the ends are least accurate."""
MIN_POSSIBLE_STRING_RADII = 40.0
"""Minimum length of a poorly supported strand that may still be a string, in radii r."""
MIN_SUPPORTED_SHARE = 0.5
"""Minimum share of well-supported points (see `MIN_STRING_SUPPORT_SHARE`) in a string."""
MIN_STRING_SUPPORT_SHARE = 0.25
"""Minimum support of a well-supported point, as a share of the median support of the longest string."""
BESIDE_RADII = (2.0, 3.0)
"""Distances from the centre line, in radii, between which other surface lies beside a strand."""
MAX_BESIDE_SHARE = 0.5
"""Maximum share of a strand that lies alone with other surface beside it.

An excluded strand that lies alone may be a string of another radius. In simulated scans with strings of two radii, or
with a wrong radius, excluded strings had up to 0.25, rarely 0.6. Edges of boxes had 0.75 and more, mostly 1.
"""
MAX_UNEVEN_SHARE = 0.65
"""Maximum share of a short string with uneven surface on both sides.

Short means less than `MIN_POSSIBLE_STRING_RADII`. In simulated scans, ridges of a rough heap had 0.8 and more. Strings
between boxes and along walls had up to 0.51 in the worst part of this length.
"""
MIN_UNEVEN_RADII = 0.5
"""Minimum height difference, from the 10th to the 90th percentile, of uneven surface beside a strand, in radii.

In simulated scans it was 1.5 to 3.4 beside ridges of a rough heap, and up to 0.05 beside strings on a plate.
"""
RESTING_RADII = (0.5, 2.5)
"""Height of the centre line of a string above the object that it rests on, in radii; more where it is crossed."""
ADVICE: Mapping[FindingCode, str] = {
    "piece-hardly-seen": "scan again from more views",
    "piece-not-round": "check the radius",
    "piece-in-table": "check the radius and the table height",
}
"""What a person can do about an excluded strand that may be a string, by the reason for which it was excluded."""


@dataclass(frozen=True, eq=False)
class StringClassification:
    """The strands that are strings, and the findings on the excluded strands."""

    strings: tuple[FittedStrand, ...]
    """Strings and their points, in the order of the model."""
    findings: tuple[Finding, ...]
    """Findings on the excluded strands: first those that may be strings, then the others, each the longest first."""


def classify_strings(
    refinement: Refinement,
    surface: NDArray[np.float64],
    parameters: ChainParameters,
    support: SupportSurface | None = None,
) -> StringClassification:
    """Select the fitted strands that are strings.

    A string is round: the surface beside it lies on its tube and has no flat top with edges. Its tube does not reach
    into the table. It is long enough, and the surface supports most of its points. If it is short, it is no ridge: no
    uneven surface lies on both sides of it.

    Args:
        refinement: Fitted strands, and the strand index of each surface point.
        surface: (M, 3) registered surface points, metres, base frame.
        parameters: Method parameters; uses the radius r.
        support: What the strings rest on. None means a table at z = 0.

    Returns:
        The strings in the order of the model, and the findings on the excluded strands. An excluded strand that may be
        a string gives a doubt: a long one that was hardly seen, one that lies alone on the table, unless it is
        certainly square, a long one that lies on a large object as a string would, and a ridge.
    """
    strands, support = refinement.strands, support or SupportSurface()
    on_tube_shares = _on_tube_shares(refinement, surface, parameters, support)
    kept: list[int] = []
    excluded: list[tuple[int, FindingCode, str]] = []
    lengths = [float(arc_length(close_polyline(strand.points, strand.closed))[-1]) for strand in strands]
    for k in np.argsort(-np.array(lengths), kind="stable").tolist():
        strand, length = strands[k], lengths[k]
        usual_support = float(np.median(strands[kept[0]].support)) if kept else 0.0
        is_supported = bool(np.mean(strand.support >= MIN_STRING_SUPPORT_SHARE * usual_support) >= MIN_SUPPORTED_SHARE)
        is_round = _is_round(strand, parameters.r) and on_tube_shares[k] >= MIN_ON_TUBE_SHARE
        code: FindingCode
        if length < MIN_LENGTH_RADII * parameters.r:
            code, reason = "piece-too-short", "too short to be distinguished from noise"
        elif not is_supported:
            code, reason = "piece-hardly-seen", "hardly any surface supports it"
        elif not is_round:
            code, reason = "piece-not-round", "its surface is not round enough"
        elif _is_in_table(strand, support.table_z_m):
            code, reason = "piece-in-table", "its tube would reach into the table"
        else:
            kept.append(k)
            continue
        excluded.append((k, code, reason))
    ridges = [
        k
        for k in kept
        if lengths[k] < MIN_POSSIBLE_STRING_RADII * parameters.r
        and _is_ridge(strands[k], [strands[other] for other in kept if other != k], surface, parameters.r)
    ]
    kept_strands = [strands[k] for k in kept if k not in ridges]
    reason = "uneven surface on both sides, as beside a fold or a ridge; look at it"
    possible = [excluded_piece("possible-string", strands[k].points, lengths[k], reason) for k in ridges]
    pieces = []
    for k, code, reason in excluded:
        strand, length = strands[k], lengths[k]
        match code:
            case "piece-too-short":
                may_be_string = False
            case "piece-hardly-seen":
                may_be_string = length >= MIN_POSSIBLE_STRING_RADII * parameters.r
            case _:
                is_tube = on_tube_shares[k] >= MIN_ON_TUBE_SHARE and not _is_certainly_square(strand)
                may_be_string = is_tube and _lies_alone(strand, kept_strands, surface, parameters.r)
                is_long = length >= MIN_POSSIBLE_STRING_RADII * parameters.r
                may_be_string |= is_long and _rests_on_object(strand, support)
        if may_be_string:
            possible.append(excluded_piece("possible-string", strand.points, length, f"{reason}; {ADVICE[code]}"))
        else:
            pieces.append(excluded_piece(code, strand.points, length, reason))
    strings = sorted(map(_orient, kept_strands), key=lambda string: order_key(string.points, string.closed))
    return StringClassification(tuple(strings), (*possible, *shortened(pieces)))


def max_squareness(strand: FittedStrand) -> float:
    """Return the upper bound of the squareness of a strand, given its uncertainty. Infinite if it is not measured."""
    return strand.squareness + UNCERTAIN_SIGMAS * strand.squareness_sigma


def _is_round(strand: FittedStrand, r: float) -> bool:
    return strand.roundness_error_m <= MAX_ROUNDNESS_ERROR * max(strand.radius_m, r) and not _is_square(strand)


def _is_square(strand: FittedStrand) -> bool:
    return strand.squareness > max(MAX_SQUARENESS, UNCERTAIN_SIGMAS * strand.squareness_sigma)


def _is_certainly_square(strand: FittedStrand) -> bool:
    return strand.squareness - UNCERTAIN_SIGMAS * strand.squareness_sigma > MAX_SQUARENESS


def _is_ridge(strand: FittedStrand, others: Sequence[FittedStrand], surface: NDArray[np.float64], r: float) -> bool:
    """Return whether uneven surface lies on both sides of a strand, apart from the surface of other strands."""
    beside = _surface_beside(strand, others, surface, r)
    if len(beside) == 0:
        return False
    radius = max(strand.radius_m, r)
    along = np.gradient(strand.points, axis=0)[:, :2]
    left = np.column_stack([-along[:, 1], along[:, 0]]) / np.linalg.norm(along, axis=1, keepdims=True).clip(min=1e-9)
    between, heights = 0, []
    for point, to_left, near in zip(
        strand.points, left, KDTree(beside).query_ball_point(strand.points, BESIDE_RADII[1] * radius), strict=True
    ):
        offset = (beside[near, :2] - point[:2]) @ to_left
        sides = [beside[near, 2][offset > radius], beside[near, 2][offset < -radius]]
        if all(len(z) for z in sides):
            between += 1
            heights.extend(float(np.median(z)) for z in sides)
    if between <= MAX_UNEVEN_SHARE * len(strand.points):
        return False
    low, high = np.percentile(heights, (10, 90))
    return bool(high - low >= MIN_UNEVEN_RADII * radius)


def _lies_alone(strand: FittedStrand, kept: Sequence[FittedStrand], surface: NDArray[np.float64], r: float) -> bool:
    """Return whether hardly any surface lies beside a strand, apart from the surface of the kept strands."""
    beside = _surface_beside(strand, kept, surface, r)
    if len(beside) == 0:
        return True
    reach = BESIDE_RADII[1] * max(strand.radius_m, r)
    return float(np.mean(KDTree(beside).query(strand.points)[0] < reach)) <= MAX_BESIDE_SHARE


def _surface_beside(
    strand: FittedStrand, others: Sequence[FittedStrand], surface: NDArray[np.float64], r: float
) -> NDArray[np.float64]:
    """Return the surface points (N, 3) beside a strand, without the surface of other strands."""
    radius = max(strand.radius_m, r)
    distance, _ = KDTree(strand.points).query(surface, distance_upper_bound=2 * BESIDE_RADII[1] * radius)
    beside = surface[np.isfinite(distance) & (np.asarray(distance) > BESIDE_RADII[0] * radius)]
    if not others or len(beside) == 0:
        return beside
    tree = KDTree(np.vstack([other.points for other in others]))
    reach = BESIDE_RADII[0] * max(r, *(other.radius_m for other in others))
    return beside[tree.query(beside)[0] > reach]


def _rests_on_object(strand: FittedStrand, support: SupportSurface) -> bool:
    """Return whether a strand lies on a large object as a string would, about one radius above it."""
    height = support.height_under(strand.points, strand.radius_m)
    above = float(np.median(strand.points[:, 2])) - height
    low, high = (share * strand.radius_m for share in RESTING_RADII)
    return height > support.table_z_m and low <= above <= high


def _is_in_table(strand: FittedStrand, table_z_m: float) -> bool:
    height = float(np.percentile(strand.points[:, 2], HEIGHT_PERCENTILE)) - table_z_m
    return height < MIN_HEIGHT_SHARE * strand.radius_m


def _on_tube_shares(
    refinement: Refinement, surface: NDArray[np.float64], parameters: ChainParameters, support: SupportSurface
) -> NDArray[np.float64]:
    """Return the share (K,) of the surface points beside each strand that lie on its tube, 0 to 1.

    Each surface point counts for the nearest strand only. Beside a strand that rests on an object, only points at more
    than z_t above the object count, as the height threshold has removed the table but not the object.
    """
    strands = refinement.strands
    if not strands:
        return np.empty(0)
    strand_of_line_point = np.repeat(np.arange(len(strands)), [len(strand.points) for strand in strands])
    radii = np.array([max(strand.radius_m, parameters.r) for strand in strands])
    floor = np.array([support.height_under(strand.points, strand.radius_m) for strand in strands])
    lowest = np.where(floor > support.table_z_m, floor + parameters.z_t, -np.inf)
    distance, indices = KDTree(np.vstack([strand.points for strand in strands])).query(surface)
    nearest = strand_of_line_point[np.asarray(indices)]
    is_beside = (np.asarray(distance) < MAX_BESIDE_RADII * radii[nearest]) & (surface[:, 2] > lowest[nearest])
    nearest, actual = nearest[is_beside], refinement.strand_of_point[is_beside]
    count = np.bincount(nearest, minlength=len(strands))
    return np.bincount(nearest, actual == nearest, len(strands)) / np.maximum(count, 1)


def _orient(strand: FittedStrand) -> FittedStrand:
    """Bring the points of a strand into the order of the model (see `canonical_line`)."""
    line = canonical_line(strand.points, strand.closed)
    bridged, support = strand.bridged[line.source], strand.support[line.source]
    return replace(strand, points=line.points, bridged=bridged, support=support)
