"""Assembly of the model's chains from fitted strands."""

from dataclasses import dataclass

import numpy as np

from recognition.assembly.uncertainty import point_uncertainty
from recognition.messages import format_position
from recognition.model.chains import Chain, End
from recognition.parameters import ChainParameters
from recognition.preprocessing.target_cloud import Scene
from recognition.refinement.refinement import RESTING_PERCENTILE, FittedStrand, Refinement
from recognition.refinement.string_classifier import classify_strings, may_be_square
from recognition.registration.registration import Registration
from recognition.tracing.height_map import HeightMap

MAX_TABLE_GAP_RADII = 0.4
"""Maximum gap between the table and a string, in radii of the string. A larger gap gives a warning."""
MAX_THINNER_SHARE = 0.25
"""Maximum share of r by which a string may be thinner than r. A thinner string gives an ambiguity.

Recognition mistakes parts of a thinner string for the table or for noise. It finds all of a thicker string.
"""


@dataclass(frozen=True, eq=False)
class ChainAssembly:
    """The chains of a scene, and the messages about them."""

    chains: tuple[Chain, ...]
    """Chains in the order of their `id`."""
    ambiguities: tuple[str, ...]
    """Messages about chains that may not be strings, and about strings that may be incomplete."""
    warnings: tuple[str, ...]
    """Messages about excluded strands, and about chains that contradict the expected radius or the table height."""


def assemble_fitted_chains(
    refinement: Refinement, registration: Registration, height_map: HeightMap, scene: Scene, parameters: ChainParameters
) -> ChainAssembly:
    """Build the chains of the model from the fitted strands that are classified as strings.

    Args:
        refinement: Fitted strands, and the standard deviation of the surface points about their tubes.
        registration: Registered views and their merged surface.
        height_map: Height map of the registered surface.
        scene: Scene; uses the table height and the workspace.
        parameters: Method parameters; uses the radius r and the border margin r_f.

    Returns:
        The chains with sigmas, view counts and ends, and the messages about the chains and the excluded strands.
    """
    classified = classify_strings(refinement, registration.points, parameters, scene.table_z_m)
    ambiguities, warnings = list(classified.ambiguities), list(classified.warnings)
    if not classified.strings:
        warnings.insert(
            0,
            f"no string of radius {parameters.r * 1000:.1f} mm found: nothing above the table is long, round and about "
            "as thick; check the radius",
        )
    chains: list[Chain] = []
    for number, strand in enumerate(classified.strings):
        sigma_m, views = point_uncertainty(strand, registration, refinement.scatter_m)
        ends = classify_ends(strand, height_map, scene, parameters)
        chains.append(Chain(number, strand.closed, strand.radius_m, strand.points, sigma_m, views, ends))
        if may_be_square(strand):
            ambiguities.append(
                f"chain {number} at {format_position(strand.points.mean(axis=0))} may be a bar with edges instead of a "
                "string: the measured surface does not show whether it is round"
            )
        gap = float(np.percentile(strand.points[:, 2], RESTING_PERCENTILE)) - scene.table_z_m - strand.radius_m
        if gap > MAX_TABLE_GAP_RADII * strand.radius_m:
            warnings.append(
                f"chain {number} lies {gap * 1000:.1f} mm above the table along nearly all its length: it rests on "
                "something, or it is the edge of an object"
            )
        if strand.radius_m != parameters.r:  # The measured radius contradicts r.
            message = (
                f"chain {number} measures {strand.measured_radius_m * 1000:.1f} mm in radius, not the expected "
                f"{parameters.r * 1000:.1f} mm"
            )
            if strand.measured_radius_m < (1 - MAX_THINNER_SHARE) * parameters.r:
                ambiguities.append(
                    f"{message}: parts and ends of thinner strings are missed; give the radius of the thinnest string"
                )
            elif strand.measured_radius_m < parameters.r:
                warnings.append(
                    f"{message}: thinner strings beside it may be missed; give the radius of the thinnest string"
                )
            else:
                warnings.append(message)
    return ChainAssembly(tuple(chains), tuple(ambiguities), tuple(warnings))


def classify_ends(
    strand: FittedStrand, height_map: HeightMap, scene: Scene, parameters: ChainParameters
) -> tuple[End, End]:
    """Classify the ends of a strand: `free` if the end of the string was observed, else `unseen`.

    An end is `unseen` if it lies near the border of the workspace or if another strand lies over its continuation.

    Args:
        strand: Fitted strand.
        height_map: Height map of the registered surface.
        scene: Scene; uses the workspace.
        parameters: Method parameters; uses the radius r and the border margin r_f.

    Returns:
        The kinds of the first and the last end. A closed strand has two `free` ends.
    """
    if strand.closed:
        return "free", "free"
    kinds: list[End] = []
    for points in (strand.points, strand.points[::-1]):
        outward = points[0] - points[min(3, len(points) - 1)]
        outward[2] = 0.0
        outward /= max(float(np.linalg.norm(outward)), 1e-12)
        ahead = points[0] + np.linspace(0.3, 1.3, 5)[:, None] * parameters.r * outward
        hidden = height_map.occlusion(ahead, max(parameters.r, strand.radius_m)).is_occluded.mean() > 0.5
        kinds.append("unseen" if hidden or scene.is_near_border(points[0], parameters.r_f) else "free")
    return kinds[0], kinds[1]
