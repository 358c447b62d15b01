"""Measure the string radius in the views if no radius is given."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from recognition.depth_correction.height_compression import estimate_radius, find_ridges
from recognition.errors import RadiusUnknownError, RecognitionError
from recognition.geometry.polyline import arc_length
from recognition.ingestion.table_and_warp import TableAndWarp
from recognition.messages import format_position
from recognition.model.chains import Chain
from recognition.model.findings import Finding, finding
from recognition.parameters import R_MAX, R_MIN, ChainParameters
from recognition.preprocessing.target_cloud import DepthView, Scene, align_view, preprocess
from recognition.radii.ridges import estimate_rough_radius
from recognition.refinement.refinement import FittedStrand
from recognition.strings import find_strings
from recognition.surface import observe
from recognition.tracing.occlusion_map import OcclusionMap

PROBE_R = 0.0015
"""Radius of the first preprocessing, metres. It gives the height threshold z_t, below which points are ignored."""
PAPER_R = 0.0042
"""Radius of the string in the paper, metres. It is used for an empty table, where no radius can be measured."""
MIN_POINTS = 50
"""Minimum number of points above the table, over all views, in a scene with a string. Fewer points are noise."""
START_RADII_M = (0.0042, 0.0025, 0.007)
"""Radii from which the search for the radius of bands starts, metres."""
MAX_STEPS = 6
"""Maximum number of steps of this search."""
MAX_CHANGE = 0.03
"""Change of the radius, as a share, below which the search ends."""
THINNER = ("radius-smaller", "radius-much-smaller")
"""Codes of chains that are thinner than the given radius."""
MIN_MISSED_RADII = 20
"""Minimum length of missed string that contradicts the given radius, in measured radii. Edges of objects and noise that
look like tubes of some radius are shorter."""


@dataclass(frozen=True, eq=False)
class MeasuredRadius:
    """Radius of the strings that the views show."""

    radius_m: float
    """Length-weighted median of the radii of `strings`, metres. Without strings, the rough radius."""
    strings: Sequence[FittedStrand] = ()
    """Strings from which the radius was measured."""


def measure_radius(measured: TableAndWarp) -> MeasuredRadius:
    """Measure the string radius in the views of a scan.

    A rough radius from the heights above the table suffices to find the strings. Tube fits to these strings then give
    the radius. Strings with a radius below about 1.5 mm are too low above the table to be measured.

    Args:
        measured: All views, with where they show the table, and the warp of their camera.

    Returns:
        The radius, and the strings that have it. If the table is empty, the radius is `PAPER_R`.

    Raises:
        RadiusUnknownError: Points above the table exist, but they do not allow a radius to be measured.
        RecognitionError: The views cannot be used, as for `recognition.pipeline.recognise`.
    """
    probe = ChainParameters.for_radius(PROBE_R)
    scene = measured.scene
    corrected = [measured.corrected(number) for number in range(len(measured.views))]
    clouds = [preprocess(view, probe, scene).points for view in corrected]
    if sum(map(len, clouds)) < MIN_POINTS:
        return MeasuredRadius(PAPER_R)
    matched_m = None if measured.locking is None else _radius_of_bands(corrected, scene)
    rough_m = estimate_rough_radius(clouds, scene.table_z_m) if matched_m is None else matched_m
    rough = ChainParameters.for_radius(rough_m)
    surface = observe(measured.views, scene, rough, earlier=measured)
    if matched_m is None and surface.ingested.drawn is not None:
        # the tubes that were drawn have the rough radius
        matched_m = _radius_of_bands(corrected, scene)
        if matched_m is not None:
            rough = ChainParameters.for_radius(matched_m)
            surface = observe(measured.views, scene, rough, earlier=measured)
    if surface.no_string_reason is not None:
        return MeasuredRadius(rough.r)
    # Radii do not depend on what the depth images show beside the surface. The search for it would take time.
    surface = replace(surface, clouds=(), occlusion_map=OcclusionMap(surface.points))
    # Each string has a measured radius, whether or not its tube has the rough one.
    strings = find_strings(surface, rough).classified.strings
    if not strings and measured.locking is not None:
        raise RadiusUnknownError(
            f"what is above the table may be strings with a radius of about {rough.r * 1000:.1f} mm, but no string was "
            "found with it, so no radius can be measured: give the radius"
        )
    if matched_m is not None or not strings:
        # heights of matched depth were restored to those of the rough radius, so the tubes show no other
        return MeasuredRadius(rough.r, strings)
    return MeasuredRadius(_median_radius(strings), strings)


def other_radius_findings(
    measured: TableAndWarp, parameters: ChainParameters, chains: Sequence[Chain], findings: Sequence[Finding]
) -> tuple[Finding, ...]:
    """Return the finding on strings that are missed because they do not have the given radius.

    If there is no chain, or one is thinner than the given radius, the radius is measured as if none was given. If that
    finds much more string than the chains have, the given radius is wrong. The measurement takes as long as the
    recognition itself.

    Args:
        measured: Views that the chains were recognised in.
        parameters: Parameters for the given radius.
        chains: Recognised chains, perhaps none.
        findings: Findings on the chains.
    """
    if chains and not any(found.code in THINNER for found in findings):
        return ()
    try:
        other = measure_radius(measured)
    except RecognitionError:  # nothing looks like a string of any radius
        return ()
    if not other.strings:
        return ()
    lengths_m = [arc_length(string.points)[-1] for string in other.strings]
    recognised_m = sum(chain.length_m for chain in chains)
    if sum(lengths_m) - recognised_m < MIN_MISSED_RADII * other.radius_m:
        return ()
    longest = other.strings[int(np.argmax(lengths_m))].points
    middle = longest[len(longest) // 2]
    found = "no string" if not chains else f"only {recognised_m * 1000:.0f} mm of string"
    message = (
        f"with the radius {parameters.r * 1000:.1f} mm {found} was found, but {sum(lengths_m) * 1000:.0f} mm with a "
        f"measured radius of {other.radius_m * 1000:.1f} mm, for example at {format_position(middle)}: recognise the "
        "scan again with this radius, or with none"
    )
    return (finding("string-of-other-radius", message, point=middle, value=other.radius_m, limit=parameters.r),)


def _radius_of_bands(views: Sequence[DepthView], scene: Scene) -> float | None:
    """Return the radius at which the bands in matched depth have the size of strings, metres, or None if none does."""
    for start_m in START_RADII_M:
        radius_m = start_m
        for _ in range(MAX_STEPS):
            parameters = ChainParameters.for_radius(radius_m)
            ridges = [find_ridges(align_view(view, parameters, scene)) for view in views]
            estimate_m = estimate_radius(ridges, radius_m)
            if estimate_m is None:
                break
            change = estimate_m / radius_m - 1
            radius_m = float(np.clip(estimate_m, R_MIN, R_MAX))
            if abs(change) < MAX_CHANGE:
                return radius_m
    return None


def _median_radius(strings: Sequence[FittedStrand]) -> float:
    """Return the length-weighted median of the measured radii, metres."""
    by_radius = sorted(strings, key=lambda string: string.measured_radius_m)
    length = np.cumsum([arc_length(string.points)[-1] for string in by_radius])
    return by_radius[int(np.searchsorted(length, length[-1] / 2))].measured_radius_m
