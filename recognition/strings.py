"""Strings of one radius in a surface, by the method `graph`: centre line, tracing, refinement, classification."""

from dataclasses import dataclass

from recognition.centre_line import CentreLine, estimate_centre_line
from recognition.parameters import ChainParameters
from recognition.refinement.refinement import Refinement, refine
from recognition.refinement.string_classifier import StringClassification, classify_strings
from recognition.stage_timer import Begin, ignore_stage
from recognition.surface import Surface
from recognition.tracing.trace import TracedStrands, trace_strands


@dataclass(frozen=True, eq=False)
class Strings:
    """Strings of one radius, with the result of each step."""

    centre_line: CentreLine
    """Centre points (eq. 1) of the surface."""
    traced: TracedStrands
    """Nodes, fragments, pairs of ends and strands."""
    refinement: Refinement
    """Strands after the tube fit."""
    classified: StringClassification
    """The strands that are strings, and the findings on the others."""


def find_strings(
    surface: Surface, parameters: ChainParameters, *, radius_is_given: bool = True, begin: Begin = ignore_stage
) -> Strings:
    """Find the strings of one radius in a surface.

    Args:
        surface: Surface above the table, in which strings are searched.
        parameters: Method parameters for the radius.
        radius_is_given: Whether r is the given radius. If it is only a rough one, each tube has its measured radius.
        begin: Called with the name of each stage when it begins.

    Raises:
        TooCrowdedError: The surface has too many fragments for strings.

    Source:
        Eqs. (1) and (2) for the centre line. The other steps are not in the paper.
    """
    begin("centre_line")
    centre_line = estimate_centre_line(surface.points, surface.normals, parameters)

    begin("matching")
    traced = trace_strands(centre_line.unaveraged, surface.occlusion_map, parameters, surface.support.table_z_m)

    begin("refinement")
    refinement = refine(
        traced.strands,
        surface.points,
        surface.normals,
        parameters,
        surface.support,
        views=surface.clouds,
        radius_is_given=radius_is_given,
        other_lines=surface.known_lines,
        bends=traced.pairing.bends,
    )
    classified = classify_strings(refinement, surface.points, parameters, surface.support)
    return Strings(centre_line, traced, refinement, classified)
