"""All findings on a scene apart from those on its grasps, from what the stages found."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from recognition.assembly.chain_ends import unobserved_end_findings
from recognition.assembly.checked_chains import CheckedChains
from recognition.assembly.sharp_bends import sharp_bend_findings
from recognition.assembly.stereo_findings import stereo_findings, uncertain_radius_findings
from recognition.assembly.table_frame import table_findings
from recognition.assembly.unexplained import missed_string_findings, possible_object_findings, unexplained_findings
from recognition.assembly.view_findings import (
    drift_findings,
    noise_findings,
    single_view_findings,
    view_findings,
    warp_findings,
)
from recognition.ingestion.seen_cells import is_single_viewpoint
from recognition.methods import FoundChains
from recognition.model.chains import Chain
from recognition.model.findings import Finding, finding
from recognition.preprocessing.coverage import coverage_findings
from recognition.radii.radius_measurement import other_radius_findings
from recognition.request import RecognitionRequest
from recognition.surface import Surface


def scene_findings(
    surface: Surface,
    found: FoundChains,
    checked: CheckedChains,
    request: RecognitionRequest,
) -> Sequence[Finding]:
    """Return the findings on a scene with a string in view, apart from those on its grasps."""
    chains = checked.chains
    parameters = surface.parameters
    registration = surface.registration
    ingested = surface.ingested
    used = [view.index for view in registration.views if view.used]
    refinement = found.stages.refinement if chains else None
    return (
        *_radius_findings(surface, request, chains, found.findings),
        *found.crossings.findings,
        *found.connection_findings,
        *sharp_bend_findings(chains),
        *found.findings,
        *possible_object_findings(checked.unexplained, chains, parameters),
        *checked.contact_findings,
        *unobserved_end_findings(chains, surface.scene, parameters),
        *_missed_strings(checked.unexplained, found, surface),
        *unexplained_findings(checked.unexplained, parameters),
        *drift_findings(registration, chains),
        *table_findings(ingested.measured.table, chains),
        *warp_findings(ingested.measured.warp),
        *stereo_findings(ingested.measured.locking, ingested.compression, ingested.drawn, refinement, parameters.r),
        *single_view_findings(registration.views, ingested.clouds, chains),
        *noise_findings(registration, parameters),
        *view_findings(surface.views_quality, ingested.captured, chains),
        *coverage_findings(ingested.targets, used, surface.scene),
    )


def findings_without_string(surface: Surface, request: RecognitionRequest) -> Sequence[Finding]:
    """Return the findings on a scene without a string: the reason, another radius, the table and its coverage."""
    assert surface.no_string_reason is not None
    ingested = surface.ingested
    return (
        *_radius_findings(surface, request, (), ()),
        finding("no-string-in-view", surface.no_string_reason),
        *table_findings(ingested.measured.table, ()),
        *warp_findings(ingested.measured.warp),
        *stereo_findings(ingested.measured.locking, ingested.compression, ingested.drawn, None, surface.parameters.r),
        *view_findings(surface.views_quality, ingested.captured, ()),
        *coverage_findings(ingested.targets, (), surface.scene),
    )


def _missed_strings(pieces: Sequence[NDArray[np.float64]], found: FoundChains, surface: Surface) -> Sequence[Finding]:
    """Return the doubts about surface that may be a missed string. Methods without a tube fit miss much of it.

    Surface along an excluded strand is no string, unless it is seen from one viewpoint, where strings may not be round.
    """
    refinement = found.stages.refinement
    if refinement is None:
        return ()
    lines = [strand.points for strand in refinement.strands]
    if is_single_viewpoint(surface.clouds):
        lines = [chain.points for chain in found.chains]
    # thicker strings that were excluded are no strands of the first fit
    doubted = [np.array(each.point_m) for each in found.findings if each.code == "possible-string"]
    return missed_string_findings(pieces, lines, doubted, surface.parameters, surface.scene.table_z_m)


def _radius_findings(
    surface: Surface,
    request: RecognitionRequest,
    chains: Sequence[Chain],
    findings: Sequence[Finding],
) -> Sequence[Finding]:
    """Return the finding that a given radius is probably wrong, or that a measured one is uncertain."""
    measured = surface.ingested.measured
    if request.radius_m is None:
        return uncertain_radius_findings(surface.ingested.is_matched, surface.parameters.r, chains)
    return other_radius_findings(measured, surface.parameters, chains, findings)
