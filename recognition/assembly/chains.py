"""Assembly of the model's chains from fitted strands."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from recognition.assembly.string_contacts import rests_on_both_sides
from recognition.assembly.uncertainty import point_uncertainty
from recognition.messages import format_position
from recognition.model.canonical_order import order_key
from recognition.model.chains import Chain, End
from recognition.model.findings import Finding, finding
from recognition.parameters import ChainParameters
from recognition.preprocessing.support_surface import SupportSurface
from recognition.preprocessing.target_cloud import Scene
from recognition.refinement.object_shapes import is_other_rod, may_be_matched_bar
from recognition.refinement.refinement import RESTING_PERCENTILE, FittedStrand
from recognition.refinement.string_classifier import (
    MAX_SQUARENESS,
    StringClassification,
    max_squareness,
)
from recognition.registration.registration import Registration
from recognition.tracing.occlusion_map import OcclusionMap

MAX_TABLE_GAP_RADII = 0.4
"""Maximum gap between the table and a string, in radii of the string. A larger gap gives a finding."""
OUTWARD_LINKS = 3
"""Number of links at an end over which its direction is measured."""
AHEAD_RADII = (0.3, 1.3)
"""Range of the distances ahead of an end, in radii r, at which another strand over the end hides its continuation."""
AHEAD_POINTS = 5
"""Number of points in this range."""
MAX_HIDDEN_SHARE = 0.5
"""Maximum share of these points that another strand hides at an observed end."""
MAX_THINNER_SHARE = 0.25
"""Maximum share of r by which a string may be thinner than r. A thinner string gives a doubt.

Recognition mistakes parts of a thinner string for the table or for noise. It finds all of a thicker string.
"""


@dataclass(frozen=True, eq=False)
class ChainAssembly:
    """The chains of a scene, and the findings on them."""

    chains: tuple[Chain, ...]
    """Chains in the order of their `id`."""
    findings: tuple[Finding, ...]
    """Findings on excluded strands, and on chains that contradict the expected shape, radius or table height."""


@dataclass(frozen=True, eq=False)
class _String:
    """A string, and the surface about it."""

    strand: FittedStrand
    """Fitted strand of the string."""
    scatter_m: float
    """Standard deviation of the surface about the tubes of its pass, metres."""


def assemble_fitted_chains(
    passes: Sequence[StringClassification],
    registration: Registration,
    occlusion_map: OcclusionMap,
    scene: Scene,
    parameters: ChainParameters,
    support: SupportSurface | None = None,
) -> ChainAssembly:
    """Build the chains of the model from the strings of all passes.

    Args:
        passes: Strings of each radius, the given one first, with the standard deviation of the surface about their
            tubes.
        registration: Registered views and their merged surface.
        occlusion_map: Occlusion map of the registered surface.
        scene: Scene; uses the table height and the workspace.
        parameters: Method parameters; uses the radius r and the border margin r_f.
        support: What the strings rest on. None means the table of the scene.

    Returns:
        The chains with sigmas, view counts and ends, and the findings on the chains and the excluded strands.
    """
    support = support or SupportSurface(scene.table_z_m)
    findings: list[Finding] = []
    strings: list[_String] = []
    for found in passes:
        findings += found.findings
        strings += [_String(strand, found.scatter_m) for strand in found.strings]
    strings.sort(key=lambda string: order_key(string.strand.points, string.strand.closed))
    if not strings:
        message = (
            f"no string of radius {parameters.r * 1000:.1f} mm found: nothing above the table is long, round and about "
            "as thick; check the radius"
        )
        findings.insert(0, finding("no-string-found", message))
    chains: list[Chain] = []
    for number, string in enumerate(strings):
        strand = string.strand
        sigma_m, views = point_uncertainty(strand, registration, string.scatter_m)
        chains.append(
            Chain(
                id=number,
                closed=strand.closed,
                radius_m=strand.radius_m,
                points=strand.points,
                sigma_m=sigma_m,
                views=views,
                ends=classify_ends(strand, occlusion_map, scene, parameters),
            )
        )
    for chain, string in zip(chains, strings, strict=True):
        findings += _shape_findings(chain, string.strand, support, chains)
        findings += _radius_findings(chain, string.strand, parameters)
        if is_other_rod(string.strand, parameters.r):
            findings.append(_possible_rod(chain))
    return ChainAssembly(tuple(chains), tuple(findings))


def classify_ends(
    strand: FittedStrand, occlusion_map: OcclusionMap, scene: Scene, parameters: ChainParameters
) -> tuple[End, End]:
    """Classify the ends of a strand: `free` if the end of the string was observed, else `unobserved`.

    An end is `unobserved` if it lies near the border of the workspace or if another strand lies over its continuation.

    Args:
        strand: Fitted strand.
        occlusion_map: Occlusion map of the registered surface.
        scene: Scene; uses the workspace.
        parameters: Method parameters; uses the radius r and the border margin r_f.

    Returns:
        The kinds of the first and the last end. A closed strand has two `free` ends.
    """
    if strand.closed:
        return "free", "free"
    kinds: list[End] = []
    for points in (strand.points, strand.points[::-1]):
        outward = points[0] - points[min(OUTWARD_LINKS, len(points) - 1)]
        outward[2] = 0.0
        outward /= max(float(np.linalg.norm(outward)), 1e-12)
        ahead = points[0] + np.linspace(*AHEAD_RADII, AHEAD_POINTS)[:, None] * parameters.r * outward
        occlusion = occlusion_map.occlusion(ahead, max(parameters.r, strand.radius_m))
        is_hidden = occlusion.is_occluded.mean() > MAX_HIDDEN_SHARE
        kind: End = "free"
        if is_hidden or scene.is_near_border(points[0], parameters.r_f):
            kind = "unobserved"
        kinds.append(kind)
    return kinds[0], kinds[1]


def _shape_findings(
    chain: Chain, strand: FittedStrand, support: SupportSurface, chains: Sequence[Chain]
) -> list[Finding]:
    """Return the findings on a chain that may not be round, and on a chain that lies on nothing that is known."""
    findings = []
    squareness = max_squareness(strand)
    is_square = squareness > MAX_SQUARENESS
    if is_square or (support.is_matched and may_be_matched_bar(strand)):
        centre = chain.points.mean(axis=0)
        reason = "the measured surface does not show whether it is round"
        if not is_square:
            reason = "it is as straight as a bar, and depth that was matched in windows does not show edges"
        message = f"chain {chain.id} at {format_position(centre)} may be a bar with edges instead of a string: {reason}"
        # Without a measurement, the squareness is unlimited. JSON has no infinity.
        value = squareness if is_square and np.isfinite(squareness) else None
        limit = MAX_SQUARENESS if is_square else None
        findings.append(finding("possible-bar", message, chains=(chain.id,), point=centre, value=value, limit=limit))
    height = support.height_under(chain.points, chain.radius_m)
    gap = float(np.percentile(chain.points[:, 2], RESTING_PERCENTILE)) - height - chain.radius_m
    max_gap = MAX_TABLE_GAP_RADII * chain.radius_m
    if gap > max_gap and not rests_on_both_sides(chain, chains, height, max_gap):
        message = (
            f"chain {chain.id} lies {gap * 1000:.1f} mm above what is beside it along nearly all its length: it "
            "rests on something narrow, or it is the edge of an object"
        )
        findings.append(finding("above-table", message, chains=(chain.id,), value=gap, limit=max_gap))
    return findings


def _possible_rod(chain: Chain) -> Finding:
    centre = chain.points.mean(axis=0)
    message = (
        f"chain {chain.id} at {format_position(centre)} is straight and has another radius than expected: it may be a "
        "pen or a rod instead of a string"
    )
    return finding("possible-rod", message, chains=(chain.id,), point=centre, value=chain.radius_m)


def _radius_findings(chain: Chain, strand: FittedStrand, parameters: ChainParameters) -> list[Finding]:
    """Return the finding on a chain whose measured radius contradicts the radius r."""
    if strand.radius_m == parameters.r:
        return []
    measured = strand.measured_radius_m
    message = (
        f"chain {chain.id} measures {measured * 1000:.1f} mm in radius, not the expected {parameters.r * 1000:.1f} mm"
    )
    if measured < (1 - MAX_THINNER_SHARE) * parameters.r:
        code = "radius-much-smaller"
        message += ": parts and ends of thinner strings are missed; give the radius of the thinnest string"
    elif measured < parameters.r:
        code = "radius-smaller"
        message += ": its ends may be some millimetres short, and thinner strings beside it may be missed; give the "
        message += "radius of the thinnest string"
    else:
        code = "radius-larger"
    return [finding(code, message, chains=(chain.id,), value=measured, limit=parameters.r)]
