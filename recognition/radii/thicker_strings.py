"""Strings that are much thicker than the given radius: measured and recognised on the surface that no string explains.

The centre points of eq. (1) lie on a line only if the radius is about right. A string with twice the given radius gives
a tube instead, so that the first pass finds no line in it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from recognition.excluded_pieces import excluded_piece
from recognition.geometry.polyline import arc_length, close_polyline, resample
from recognition.geometry.voxel_grid import voxel_means
from recognition.model.findings import Finding
from recognition.parameters import R_MAX, ChainParameters
from recognition.preprocessing.support_surface import SupportSurface
from recognition.radii.ridges import CELL_M, MAX_HEIGHT_M, measure_ridges
from recognition.refinement.refinement import FittedStrand, Refinement
from recognition.refinement.string_classifier import (
    MAX_SQUARENESS,
    MIN_LENGTH_RADII,
    StringClassification,
    classify_strings,
    max_squareness,
)
from recognition.registration.fusion import MIN_NORMAL_LENGTH, VOXEL_RADII
from recognition.strings import Strings, find_strings
from recognition.surface import Surface
from recognition.tracing.end_pairing import AmbiguousPair

Points = NDArray[np.float64]

MIN_POINTS = 500
"""Minimum number of surface points on no string. A string of the minimum length with twice the radius r has about 1100;
noise around strings has fewer."""
SAMPLE_STRIDE = 4
"""Stride of the surface points in the first count of this surface. It saves time where there is none."""
MIN_THICKER_SHARE = 1.25
"""Minimum radius of a thicker string, in radii r. The first pass finds strings of up to 1.5 r."""
MAX_PASSES = 3
"""Maximum number of passes over the rest of the surface. Each one finds strings of similar radii."""
OWN_RADII = 1.35
"""Maximum distance of the surface of a string from its centre line, in radii of the string."""
FAR_RADII = 2.0
"""Minimum distance of surface that belongs to no string from the centre line of a string, in radii of the string."""
MIN_BOW_RADII = 1.0
"""Minimum distance of a string from the straight line through its ends, in radii. A straighter strand may be a pen or a
rod."""


@dataclass(frozen=True, eq=False)
class StringsOfAllRadii:
    """Strings of a scene, whatever their radii."""

    passes: tuple[StringClassification, ...]
    """Strings and findings of each pass. The first pass uses the given radius."""
    ambiguous: tuple[AmbiguousPair, ...]
    """Ambiguous pairs of ends of all passes."""


def find_thicker_strings(surface: Surface, first: Strings) -> StringsOfAllRadii:
    """Search the surface that no string of the given radius explains for strings of larger radii.

    The rest is searched only if it looks like a string: as high as it is wide over the length of a string. Its radius
    is measured, and strings are searched with it. A thicker strand is a string only if it is certainly round and bent.
    Otherwise it may be a bar or a rod, and gives a doubt.

    Without a string of the given radius, the given radius is perhaps wrong. The rest is not searched then.

    Args:
        surface: Whole surface above the table.
        first: Strings of the given radius.

    Returns:
        The strings of all passes.
    """
    parameters = surface.parameters
    first_ambiguous = tuple(first.traced.pairing.ambiguous)
    is_rest = first.refinement.strand_of_point < 0
    if not first.classified.strings or np.count_nonzero(is_rest) < MIN_POINTS:
        return StringsOfAllRadii((first.classified,), first_ambiguous)
    passes = [first.classified]
    known = list(first.classified.strings)
    thicker_strings: list[FittedStrand] = []
    ambiguous: list[AmbiguousPair] = []
    for _ in range(MAX_PASSES):
        radius_m = _radius_of_rest(surface.points, known, surface.support, parameters)
        if radius_m is None:
            break
        thicker = _scaled(parameters, radius_m)
        further = find_strings(_rest(surface, known, thicker.r), thicker, radius_is_given=False)
        found = _certain(further.classified)
        passes.append(found)
        if not found.strings:
            break
        known += found.strings
        thicker_strings += found.strings
        # Other strands of this pass lie on the remains of thinner strings, or on objects.
        pairs = further.traced.pairing.ambiguous
        ambiguous += [pair for pair in pairs if _lies_along(pair, found.strings, OWN_RADII)]
    if not thicker_strings:
        return StringsOfAllRadii(tuple(passes), first_ambiguous)
    passes[0] = _classify_rest(first.refinement, surface, thicker_strings, parameters)
    # No string lies inside the tube of another one.
    outside = [pair for pair in first_ambiguous if not _lies_along(pair, thicker_strings, 1.0)]
    return StringsOfAllRadii(tuple(passes), (*outside, *ambiguous))


def _rest(surface: Surface, known: Sequence[FittedStrand], r: float) -> Surface:
    """Return the surface without that of known strings, its points averaged for the radius `r`, metres."""
    is_rest = _distance_radii(surface.points, known) > OWN_RADII
    points, normals = _average_per_voxel(surface.points[is_rest], surface.normals[is_rest], r)
    lines = tuple(string.points for string in known)
    return replace(surface, points=points, normals=normals, known_lines=lines)


def _radius_of_rest(
    surface: Points, known: Sequence[FittedStrand], support: SupportSurface, parameters: ChainParameters
) -> float | None:
    """Return the radius of the strings in the rest of the surface, metres; None if the rest shows no thicker string."""
    sample = surface[::SAMPLE_STRIDE]
    if np.count_nonzero(_distance_radii(sample, known, parameters.r) > FAR_RADII) * SAMPLE_STRIDE < MIN_POINTS:
        return None
    rest = surface[_distance_radii(surface, known, parameters.r) > FAR_RADII]
    rest = rest[rest[:, 2] - support.table_z_m < MAX_HEIGHT_M]
    if len(rest) < MIN_POINTS:
        return None
    radii = measure_ridges(rest, support.table_z_m)
    if len(radii) == 0:
        return None
    radius_m = float(np.median(radii))
    # Each ridge cell stands for one millimetre of string.
    is_long = len(radii) * CELL_M >= MIN_LENGTH_RADII * radius_m
    return radius_m if is_long and MIN_THICKER_SHARE * parameters.r < radius_m < R_MAX else None


def _scaled(parameters: ChainParameters, radius_m: float) -> ChainParameters:
    """Return the parameters for another radius. The height threshold z_t stays, as it has been applied."""
    scale = radius_m / parameters.r
    lengths = ("r", "r_c", "r_s", "r_n", "r_f", "r_cn", "r_cf")
    return replace(parameters, **{name: scale * getattr(parameters, name) for name in lengths})


def _average_per_voxel(points: Points, normals: Points, r: float) -> tuple[Points, Points]:
    """Average the surface points and their normals in the voxels of the radius `r`, metres."""
    points, normals = voxel_means(points, VOXEL_RADII * r, normals)
    length = np.linalg.norm(normals, axis=1)
    has_side = length > MIN_NORMAL_LENGTH
    return points[has_side], normals[has_side] / length[has_side, None]


def _certain(found: StringClassification) -> StringClassification:
    """Keep the strings that are certainly round and bent. The others give a doubt, as those that may be strings do."""
    strings: list[FittedStrand] = []
    findings: list[Finding] = [finding for finding in found.findings if finding.code == "possible-string"]
    for string in found.strings:
        if max_squareness(string) > MAX_SQUARENESS:
            reason = "it is thicker than the given radius, and perhaps a bar with edges; look at it"
        elif not string.closed and _bow_radii(string) < MIN_BOW_RADII:
            reason = "it is thicker than the given radius, and straight like a pen or a rod; look at it"
        else:
            strings.append(string)
            continue
        length_m = float(arc_length(close_polyline(string.points, string.closed))[-1])
        findings.append(excluded_piece("possible-string", string.points, length_m, reason))
    return replace(found, strings=tuple(strings), findings=tuple(findings))


def _bow_radii(string: FittedStrand) -> float:
    """Return the largest distance of a string from the straight line through its ends, in radii of the string."""
    offset = string.points - string.points[0]
    chord = offset[-1] / max(float(np.linalg.norm(offset[-1])), 1e-12)
    return float(np.linalg.norm(offset - (offset @ chord)[:, None] * chord, axis=1).max()) / string.radius_m


def _classify_rest(
    refinement: Refinement, surface: Surface, thicker: Sequence[FittedStrand], parameters: ChainParameters
) -> StringClassification:
    """Classify the strands of the first pass again, without the strands and the surface of the thicker strings.

    No string lies inside the tube of another one. Such a strand was traced on the surface of the thicker string.
    """
    is_kept = [np.mean(_distance_radii(strand.points, thicker) < 1) < 0.5 for strand in refinement.strands]
    # Numbers of the kept strands among them. The last entry is that of no strand, -1.
    number = np.append(np.where(is_kept, np.cumsum(is_kept) - 1, -1), -1)
    is_rest = _distance_radii(surface.points, thicker) > OWN_RADII
    rest = Refinement(
        [strand for strand, kept in zip(refinement.strands, is_kept, strict=True) if kept],
        number[refinement.strand_of_point[is_rest]],
        refinement.scatter_m,
    )
    return classify_strings(rest, surface.points[is_rest], parameters, surface.support)


def _lies_along(pair: AmbiguousPair, strings: Sequence[FittedStrand], max_radii: float) -> bool:
    """Return whether both ends of a pair are within `max_radii` radii of the centre lines of the strings."""
    return bool((_distance_radii(pair.points, strings) < max_radii).all())


def _distance_radii(points: Points, strings: Sequence[FittedStrand], min_radius_m: float = 0.0) -> NDArray[np.float64]:
    """Return the distance (N,) of each point from the nearest centre line, in radii of its string.

    Args:
        points: (N, 3) points, metres.
        strings: Strings, at least one.
        min_radius_m: Strings that are thinner than this count with this radius, metres.
    """
    nearest = np.full(len(points), np.inf)
    for string in strings:
        radius_m = max(string.radius_m, min_radius_m)
        line = resample(close_polyline(string.points, string.closed), 0.3 * radius_m)
        distance, _ = KDTree(line).query(points, distance_upper_bound=3 * FAR_RADII * radius_m)
        nearest = np.minimum(nearest, np.asarray(distance) / radius_m)
    return nearest
