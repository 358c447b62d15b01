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
from recognition.refinement.object_shapes import is_fold, is_other_rod, is_upright
from recognition.refinement.refinement import FittedStrand, Refinement
from recognition.refinement.surface_beside import is_ridge, lies_alone

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
    scatter_m: float = 0.0
    """Robust standard deviation of the surface about the tubes of the strands, metres."""


@dataclass(frozen=True, eq=False)
class _Candidate:
    """A fitted strand that may be a string."""

    strand: FittedStrand
    """Fitted strand."""
    length_m: float
    """Length of the strand, metres."""
    on_tube_share: float
    """Share of the surface points beside the strand that lie on its tube, 0 to 1."""


@dataclass(frozen=True, eq=False)
class _Excluded:
    """A candidate that is no string."""

    candidate: _Candidate
    """The excluded candidate."""
    code: FindingCode
    """Code of the finding on it."""
    reason: str
    """Why it is no string, for the message of the finding."""


@dataclass(frozen=True, eq=False)
class _Surroundings:
    """What is known of the scene around the strands."""

    surface: NDArray[np.float64]
    """(M, 3) registered surface points, metres, base frame."""
    support: SupportSurface
    """What the strings rest on."""
    r: float
    """Radius of the strings, metres."""


def classify_strings(
    refinement: Refinement,
    surface: NDArray[np.float64],
    parameters: ChainParameters,
    support: SupportSurface | None = None,
) -> StringClassification:
    """Select the fitted strands that are strings.

    A string is round: the surface beside it lies on its tube and has no flat top with edges. Its tube does not reach
    into the table. It is long enough, and the surface supports most of its points. It does not stand upright. If it is
    short, it is no ridge and no fold: no uneven surface lies on both sides of it, and it lies as low as a string of its
    radius. Beside a string, a rod is no string: it is straight, and its radius is not r.

    Args:
        refinement: Fitted strands, and the strand index of each surface point.
        surface: (M, 3) registered surface points, metres, base frame.
        parameters: Method parameters; uses the radius r.
        support: What the strings rest on. None means a table at z = 0.

    Returns:
        The strings in the order of the model, and the findings on the excluded strands. An excluded strand that may be
        a string gives a doubt: a long one that was hardly seen, one that lies alone on the table, unless it is
        certainly square, a long one that lies on a large object as a string would, a rod, a fold, and a ridge.
    """
    surroundings = _Surroundings(surface, support or SupportSurface(), parameters.r)
    candidates = _measure_candidates(refinement, surroundings, parameters.z_t)
    kept, excluded = _select_round(candidates, surroundings)
    strings, other_shapes = _select_strings(kept, surroundings)

    possible = [_possible_string(found, "look at it") for found in other_shapes]
    pieces = []
    for found in excluded:
        if _may_be_string(found, strings, surroundings):
            possible.append(_possible_string(found, ADVICE[found.code]))
        else:
            piece = found.candidate
            pieces.append(excluded_piece(found.code, piece.strand.points, piece.length_m, found.reason))
    ordered = sorted(map(_orient, strings), key=lambda string: order_key(string.points, string.closed))
    return StringClassification(tuple(ordered), (*possible, *shortened(pieces)), refinement.scatter_m)


def max_squareness(strand: FittedStrand) -> float:
    """Return the upper bound of the squareness of a strand, given its uncertainty. Infinite if it is not measured."""
    return strand.squareness + UNCERTAIN_SIGMAS * strand.squareness_sigma


def _measure_candidates(refinement: Refinement, surroundings: _Surroundings, z_t: float) -> list[_Candidate]:
    """Return all fitted strands with their lengths and shares on the tube, the longest first."""
    shares = _on_tube_shares(refinement, surroundings, z_t)
    lengths = [float(arc_length(close_polyline(strand.points, strand.closed))[-1]) for strand in refinement.strands]
    longest_first = np.argsort(-np.array(lengths), kind="stable")
    return [_Candidate(refinement.strands[k], lengths[k], float(shares[k])) for k in longest_first]


def _select_round(
    candidates: Sequence[_Candidate], surroundings: _Surroundings
) -> tuple[list[_Candidate], list[_Excluded]]:
    """Return the candidates that are round and supported, and those that are certainly no strings on the table."""
    kept: list[_Candidate] = []
    excluded: list[_Excluded] = []
    usual_support = 0.0
    for candidate in candidates:
        exclusion = _exclusion(candidate, usual_support, surroundings)
        if exclusion is not None:
            excluded.append(exclusion)
            continue
        if not kept:
            # The longest string comes first.
            usual_support = float(np.median(candidate.strand.support))
        kept.append(candidate)
    return kept, excluded


def _exclusion(candidate: _Candidate, usual_support: float, surroundings: _Surroundings) -> _Excluded | None:
    """Return why a candidate is certainly no string on the table, or None.

    `usual_support` is the median support of the longest string.
    """
    strand = candidate.strand
    is_supported = np.mean(strand.support >= MIN_STRING_SUPPORT_SHARE * usual_support) >= MIN_SUPPORTED_SHARE
    if candidate.length_m < MIN_LENGTH_RADII * surroundings.r:
        return _Excluded(candidate, "piece-too-short", "too short to be distinguished from noise")
    if not is_supported:
        return _Excluded(candidate, "piece-hardly-seen", "hardly any surface supports it")
    if not _is_round(strand, surroundings.r) or candidate.on_tube_share < MIN_ON_TUBE_SHARE:
        return _Excluded(candidate, "piece-not-round", "its surface is not round enough")
    if _is_in_table(strand, surroundings.support.table_z_m):
        return _Excluded(candidate, "piece-in-table", "its tube would reach into the table")
    if is_upright(strand.points):
        return _Excluded(candidate, "piece-upright", "it stands upright, as a post")
    return None


def _select_strings(
    kept: Sequence[_Candidate], surroundings: _Surroundings
) -> tuple[list[FittedStrand], list[_Excluded]]:
    """Return the strings among the round candidates, and those that are rods, folds or ridges."""
    rods = [candidate for candidate in kept if is_other_rod(candidate.strand, surroundings.r)]
    # If all of them are rods, they may as well be the strings.
    has_string = len(rods) < len(kept)
    strings: list[FittedStrand] = []
    excluded: list[_Excluded] = []
    for candidate in kept:
        if has_string and candidate in rods:
            reason = f"it is straight as a rod, and its radius is {candidate.strand.radius_m * 1000:.1f} mm"
        else:
            reason = _ridge_reason(candidate, kept, surroundings)
        if reason is None:
            strings.append(candidate.strand)
        else:
            excluded.append(_Excluded(candidate, "possible-string", reason))
    return strings, excluded


def _ridge_reason(candidate: _Candidate, kept: Sequence[_Candidate], surroundings: _Surroundings) -> str | None:
    """Return why a round candidate is a fold or a ridge, or None. Long ones are neither."""
    if candidate.length_m >= MIN_POSSIBLE_STRING_RADII * surroundings.r:
        return None
    if is_fold(candidate.strand, surroundings.r, surroundings.support.table_z_m):
        return "it is higher than a string of its width would lie, as a fold"
    others = [other.strand for other in kept if other is not candidate]
    if is_ridge(candidate.strand, others, surroundings.surface, surroundings.r):
        return "uneven surface on both sides, as beside a fold or a ridge"
    return None


def _may_be_string(found: _Excluded, strings: Sequence[FittedStrand], surroundings: _Surroundings) -> bool:
    """Return whether an excluded candidate may be a string after all, given the strings of the scene."""
    strand = found.candidate.strand
    is_long = found.candidate.length_m >= MIN_POSSIBLE_STRING_RADII * surroundings.r
    match found.code:
        case "piece-too-short" | "piece-upright":
            return False
        case "piece-hardly-seen":
            return is_long
    is_tube = found.candidate.on_tube_share >= MIN_ON_TUBE_SHARE and not _is_certainly_square(strand)
    if is_tube and lies_alone(strand, strings, surroundings.surface, surroundings.r):
        return True
    return is_long and _rests_on_object(strand, surroundings.support)


def _possible_string(found: _Excluded, advice: str) -> Finding:
    """Return the doubt about a candidate that may be a string."""
    candidate = found.candidate
    return excluded_piece("possible-string", candidate.strand.points, candidate.length_m, f"{found.reason}; {advice}")


def _is_round(strand: FittedStrand, r: float) -> bool:
    return strand.roundness_error_m <= MAX_ROUNDNESS_ERROR * max(strand.radius_m, r) and not _is_square(strand)


def _is_square(strand: FittedStrand) -> bool:
    return strand.squareness > max(MAX_SQUARENESS, UNCERTAIN_SIGMAS * strand.squareness_sigma)


def _is_certainly_square(strand: FittedStrand) -> bool:
    return strand.squareness - UNCERTAIN_SIGMAS * strand.squareness_sigma > MAX_SQUARENESS


def _rests_on_object(strand: FittedStrand, support: SupportSurface) -> bool:
    """Return whether a strand lies on a large object as a string would, about one radius above it."""
    height = support.height_under(strand.points, strand.radius_m)
    above = float(np.median(strand.points[:, 2])) - height
    low, high = (share * strand.radius_m for share in RESTING_RADII)
    return height > support.table_z_m and low <= above <= high


def _is_in_table(strand: FittedStrand, table_z_m: float) -> bool:
    height = float(np.percentile(strand.points[:, 2], HEIGHT_PERCENTILE)) - table_z_m
    return height < MIN_HEIGHT_SHARE * strand.radius_m


def _on_tube_shares(refinement: Refinement, surroundings: _Surroundings, z_t: float) -> NDArray[np.float64]:
    """Return the share (K,) of the surface points beside each strand that lie on its tube, 0 to 1.

    Each surface point counts for the nearest strand only. Beside a strand that rests on an object, only points at more
    than z_t above the object count, as the height threshold has removed the table but not the object.
    """
    strands = refinement.strands
    support = surroundings.support
    if not strands:
        return np.empty(0)
    strand_of_line_point = np.repeat(np.arange(len(strands)), [len(strand.points) for strand in strands])
    radii = np.array([max(strand.radius_m, surroundings.r) for strand in strands])
    floor = np.array([support.height_under(strand.points, strand.radius_m) for strand in strands])
    lowest = np.where(floor > support.table_z_m, floor + z_t, -np.inf)
    surface = surroundings.surface
    distance, indices = KDTree(np.vstack([strand.points for strand in strands])).query(surface)
    nearest = strand_of_line_point[np.asarray(indices)]
    is_beside = (np.asarray(distance) < MAX_BESIDE_RADII * radii[nearest]) & (surface[:, 2] > lowest[nearest])
    nearest = nearest[is_beside]
    actual = refinement.strand_of_point[is_beside]
    count = np.bincount(nearest, minlength=len(strands))
    return np.bincount(nearest, actual == nearest, len(strands)) / np.maximum(count, 1)


def _orient(strand: FittedStrand) -> FittedStrand:
    """Bring the points of a strand into the order of the model (see `canonical_line`)."""
    line = canonical_line(strand.points, strand.closed)
    return replace(
        strand,
        points=line.points,
        bridged=strand.bridged[line.source],
        support=strand.support[line.source],
    )
