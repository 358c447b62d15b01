"""The three methods: from the surface to chains and crossings, with the result of each stage."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from recognition.assembly.chains import assemble_fitted_chains
from recognition.assembly.connections import connection_findings
from recognition.assembly.crossings import CrossingSet, find_crossings, find_fitted_crossings
from recognition.centre_line import CentreLine, estimate_centre_line
from recognition.model.chains import Chain
from recognition.model.findings import Finding
from recognition.model.model import Method
from recognition.radii.thicker_strings import find_thicker_strings
from recognition.refinement.refinement import Refinement
from recognition.shirakawa.chains import assemble_chains
from recognition.shirakawa.enhanced_matching import EnhancedMatching
from recognition.shirakawa.method_stages import connect_segments, link_segments
from recognition.shirakawa.reconstruction import Reconstruction
from recognition.stage_timer import Begin
from recognition.strings import find_strings
from recognition.surface import Surface
from recognition.tracing.trace import TracedStrands


@dataclass(frozen=True, eq=False)
class MethodStages:
    """Result of each stage of a method. Those of stages that the method does not have are None or empty."""

    centre_line: CentreLine | None = None
    """Centre points (eq. 1) and their means (eq. 2)."""
    thinned: NDArray[np.float64] | None = None
    """(N, 3) thinned points (eq. 3) of the method `enhanced`, metres."""
    enhanced: EnhancedMatching | None = None
    """Segments, contribution rates and bifurcation centres of the method `enhanced`."""
    segments: Sequence[NDArray[np.float64]] = ()
    """(N, 3) points of each segment before reconstruction, for `matching` and `enhanced`, metres."""
    reconstruction: Reconstruction | None = None
    """Strands of the method `enhanced` after each step of the reconstruction."""
    graph: TracedStrands | None = None
    """Nodes, fragments, pairs of ends and strands of the method `graph`."""
    refinement: Refinement | None = None
    """Strands of the method `graph` after the tube fit."""


NO_STAGES = MethodStages()
"""Stages of a recognition that ended before the centre line, because no string is in view."""


@dataclass(frozen=True, eq=False)
class FoundChains:
    """Chains and crossings that a method found in a surface."""

    chains: Sequence[Chain]
    """Chains in the order of their `id`."""
    crossings: CrossingSet
    """Crossings, and the findings on uncertain ones."""
    connection_findings: Sequence[Finding]
    """Doubts about pairs of ends that may be connected differently."""
    findings: Sequence[Finding]
    """Findings on the chains, and on strands that are no strings."""
    stages: MethodStages
    """Result of each stage."""


def find_chains(surface: Surface, method: Method, begin: Begin) -> FoundChains:
    """Find the chains of a scene and their crossings by one method.

    Args:
        surface: Registered surface of the scene.
        method: Name of the method.
        begin: Called with the name of each stage when it begins.

    Raises:
        TooCrowdedError: The surface has too many fragments or segments for strings.
    """
    if method == "graph":
        return _find_by_graph(surface, begin)
    parameters = surface.parameters
    begin("centre_line")
    centre_line = estimate_centre_line(surface.points, surface.normals, parameters)

    begin("matching")
    linked = link_segments(method, centre_line.points, parameters)

    begin("reconstruction")
    strands, reconstruction = connect_segments(linked, surface.points, centre_line.unaveraged, parameters)

    begin("topology")
    assembly = assemble_chains(strands, centre_line.unaveraged, surface.clouds, surface.scene, parameters)
    crossings = find_crossings(assembly.strands, surface.points, parameters)
    stages = MethodStages(
        centre_line,
        thinned=linked.thinned,
        enhanced=linked.enhanced,
        segments=linked.segments,
        reconstruction=reconstruction,
    )
    return FoundChains(assembly.chains, crossings, (), assembly.findings, stages)


def _find_by_graph(surface: Surface, begin: Begin) -> FoundChains:
    """Find the chains by the method `graph`. See `find_chains`."""
    parameters = surface.parameters
    first = find_strings(surface, parameters, begin=begin)
    strings = find_thicker_strings(surface, first)

    begin("topology")
    assembly = assemble_fitted_chains(
        strings.passes, surface.registration, surface.occlusion_map, surface.scene, parameters, surface.support
    )
    connections = connection_findings(strings.ambiguous, assembly.chains)
    crossings = find_fitted_crossings(assembly.chains, connections)
    stages = MethodStages(first.centre_line, graph=first.traced, refinement=first.refinement)
    return FoundChains(assembly.chains, crossings, connections, assembly.findings, stages)
