"""From fitted strands to the chains of the model: how well each point is known, and what the ends are."""

import numpy as np

from recognition.assembly.uncertainty import point_uncertainty
from recognition.messages import format_position
from recognition.model.model import Chain, End
from recognition.parameters import ChainParameters
from recognition.preprocessing.target_cloud import Scene
from recognition.refinement.refinement import RESTING_PERCENTILE, FittedStrand, Refinement
from recognition.refinement.string_classifier import classify_strings, may_be_square
from recognition.registration.registration import Registration
from recognition.shirakawa.end_extension import at_border
from recognition.tracing.height_map import HeightMap

FLOATING = 0.4
"""A string rests on the table somewhere; where there is more room below all of it, as a share of its radius, that is
told."""
MUCH_THINNER = 0.25
"""Of strings thinner than told by more than this share, parts are taken for table or noise, while thicker ones are
found whole."""


def assemble_fitted_chains(
    refinement: Refinement, registration: Registration, cover: HeightMap, scene: Scene, parameters: ChainParameters
) -> tuple[tuple[Chain, ...], list[str], list[str]]:
    """The chains of the strings among the fitted strands; in words which may be no strings, or not all of them; and
    what was left out or contradicts the radius.

    `cover` looks down on the registered surface.
    """
    strands, doubts, warnings = classify_strings(refinement, registration.points, parameters, scene.table_z_m)
    if not strands:
        warnings.insert(
            0,
            f"no string of radius {parameters.r * 1000:.1f} mm found: nothing above the table is long, round and about "
            "as thick; check the radius",
        )
    chains: list[Chain] = []
    for number, strand in enumerate(strands):
        sigma_m, views = point_uncertainty(strand, registration, refinement.scatter_m)
        ends = classify_ends(strand, cover, scene, parameters)
        chains.append(Chain(number, strand.closed, strand.radius_m, strand.points, sigma_m, views, ends))
        if may_be_square(strand):
            doubts.append(
                f"chain {number} at {format_position(strand.points.mean(axis=0))} may be no string but a bar with "
                "edges: what was seen of it cannot tell"
            )
        below = float(np.percentile(strand.points[:, 2], RESTING_PERCENTILE)) - scene.table_z_m - strand.radius_m
        if below > FLOATING * strand.radius_m:
            warnings.append(
                f"chain {number} lies {below * 1000:.1f} mm above the table nearly all along: it rests on something, "
                "or is no string but the edge of a thing"
            )
        if strand.radius_m != parameters.r:  # the told one is contradicted
            said = (
                f"chain {number} measures {strand.measured_radius_m * 1000:.1f} mm in radius, not the "
                f"{parameters.r * 1000:.1f} mm that was looked for"
            )
            if strand.measured_radius_m < (1 - MUCH_THINNER) * parameters.r:
                doubts.append(f"{said}: of thinner strings, parts and ends are overlooked; tell the thinnest's radius")
            elif strand.measured_radius_m < parameters.r:
                warnings.append(f"{said}: thinner strings beside it may be overlooked; tell the thinnest's radius")
            else:
                warnings.append(said)
    return tuple(chains), doubts, warnings


def classify_ends(strand: FittedStrand, cover: HeightMap, scene: Scene, parameters: ChainParameters) -> tuple[End, End]:
    """For the first and the last point: `free` when the string was seen to stop there, else `unseen`.

    It was not seen to stop where it leaves the workspace or goes on under another strand. Both of a closed strand's
    are `free`: it has no end that was missed.
    """
    if strand.closed:
        return "free", "free"
    kinds: list[End] = []
    for points in (strand.points, strand.points[::-1]):
        way = points[0] - points[min(3, len(points) - 1)]
        way[2] = 0.0
        way /= max(float(np.linalg.norm(way)), 1e-12)
        ahead = points[0] + np.linspace(0.3, 1.3, 5)[:, None] * parameters.r * way
        hidden = cover.over(ahead, max(parameters.r, strand.radius_m))[0].mean() > 0.5
        kinds.append("unseen" if hidden or at_border(points[0], scene, parameters.r_f) else "free")
    return kinds[0], kinds[1]
