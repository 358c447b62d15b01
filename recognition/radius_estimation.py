"""The string's radius, measured, when nobody tells it."""

from collections.abc import Sequence

import numpy as np

from recognition.geometry.polyline import arc_length
from recognition.parameters import ChainParameters
from recognition.preprocessing.target_cloud import DepthView, Scene, preprocess
from recognition.refinement.refinement import refine
from recognition.refinement.string_classifier import classify_strings
from recognition.registration.registration import register
from recognition.rough_radius import estimate_rough_radius
from recognition.tracing.height_map import HeightMap
from recognition.tracing.trace import trace_strands
from recognition.view_ingestion import ingest_views

PROBE_R = 0.0015
"""Radius with which a first look is taken: what is lower than this string's threshold z_t is not looked at."""
PAPER_R = 0.0042
"""Radius of the paper's string, for scenes in which there is none to measure."""
FEW_POINTS = 50
"""Fewer points above the table than this, in all views, are noise: there is no string."""


def estimate_parameters(views: Sequence[DepthView], scene: Scene) -> ChainParameters:
    """Parameters for the radius that most of the string in the views has.

    A rough radius from the heights above the table is enough to find the strings; tubes fitted to them then tell
    it. Strings thinner than about 1.5 mm in radius do not stand out of the table for this.

    Raises:
        RadiusUnknownError: something is above the table, but nothing to measure a string's radius of.
        RecognitionError: the views cannot be used, as for `recognition.pipeline.recognise`.
    """
    probe = ChainParameters.for_radius(PROBE_R)
    looked = [preprocess(view, probe, scene) for view in views]
    if sum(len(target.points) for target in looked) < FEW_POINTS:
        return ChainParameters.for_radius(PAPER_R)
    rough = ChainParameters.for_radius(estimate_rough_radius([target.points for target in looked], scene.table_z_m))
    arrivals = ingest_views(views, rough, scene)
    if arrivals.empty_because is not None:
        return rough
    registration = register(arrivals.clouds, rough, arrivals.pairs)
    graph = trace_strands(registration.points - rough.r * registration.normals, HeightMap(registration.points), rough)
    refinement = refine(graph.strands, registration.points, registration.normals, rough, scene.table_z_m)
    strings, _, _ = classify_strings(refinement, registration.points, rough, scene.table_z_m)
    if not strings:
        return rough
    order = sorted(strings, key=lambda string: string.measured_radius_m)
    share = np.cumsum([arc_length(string.points)[-1] for string in order])
    return ChainParameters.for_radius(order[int(np.searchsorted(share, share[-1] / 2))].measured_radius_m)
