"""Estimate the string radius from the views if no radius is given."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from recognition.centre_line import estimate_centre_line
from recognition.errors import RadiusUnknownError, RecognitionError
from recognition.geometry.polyline import arc_length
from recognition.ingestion.view_ingestion import correct_views, ingest_views, merge_heights
from recognition.messages import format_position
from recognition.model.chains import Chain
from recognition.model.findings import Finding, finding
from recognition.parameters import R_MAX, R_MIN, ChainParameters
from recognition.preprocessing.support_surface import SupportSurface
from recognition.preprocessing.target_cloud import DepthView, Scene, preprocess
from recognition.refinement.refinement import FittedStrand, refine
from recognition.refinement.string_classifier import classify_strings
from recognition.registration.registration import register
from recognition.tracing.occlusion_map import OcclusionMap
from recognition.tracing.trace import trace_strands

PROBE_R = 0.0015
"""Radius of the first preprocessing, metres. It gives the height threshold z_t, below which points are ignored."""
PAPER_R = 0.0042
"""Radius of the string in the paper, metres. It is used for an empty table, where no radius can be measured."""
MIN_POINTS = 50
"""Minimum number of points above the table, over all views, in a scene with a string. Fewer points are noise."""
CELL_M = 0.001
"""Edge of the grid cells for widths and heights, seen from above, metres."""
MAX_CELLS = 4_000_000
"""Maximum number of grid cells: 2 m by 2 m."""
MAX_HEIGHT_M = 4 * R_MAX
"""Maximum height above the table, metres. Higher points belong neither to a string nor to a crossing."""
BIN_M = 0.0004
"""Width of the bins in the histogram of heights, metres."""
MAX_HEIGHT_WIDTH_RATIO = 2.0
"""Maximum ratio of height to width, and of width to height, at a ridge cell of a string."""
MIN_LENGTH_M = 0.02
"""Minimum extent of a connected piece of cells along x or y, metres. Smaller pieces are noise."""
THINNER = ("radius-smaller", "radius-much-smaller")
"""Codes of chains that are thinner than the given radius."""
MIN_MISSED_RADII = 20
"""Minimum length of missed string that contradicts the given radius, in measured radii. Edges of objects and noise that
look like tubes of some radius are shorter."""
MIN_RIDGE_CELLS = 20
"""Minimum number of ridge cells for a measurement of the radius."""


def estimate_parameters(views: Sequence[DepthView], scene: Scene) -> ChainParameters:
    """Estimate the string radius from the views, and return the method parameters for this radius.

    A rough radius from the heights above the table suffices to find the strings. Tube fits to these strings then give
    the radius. Strings with a radius below about 1.5 mm are too low above the table to be measured.

    Args:
        views: Depth images with their camera poses.
        scene: Table height and workspace.

    Returns:
        Parameters for the length-weighted median of the fitted radii. If no string is found, the parameters are for the
        rough radius. If the table is empty, they are for `PAPER_R`.

    Raises:
        RadiusUnknownError: Points above the table exist, but they do not allow a radius to be measured.
        RecognitionError: The views cannot be used, as for `recognition.pipeline.recognise`.
    """
    rough, strings = _find_strings(views, scene)
    return ChainParameters.for_radius(_median_radius(strings)) if strings else rough


def other_radius_findings(
    views: Sequence[DepthView],
    scene: Scene,
    parameters: ChainParameters,
    chains: Sequence[Chain],
    findings: Sequence[Finding],
) -> tuple[Finding, ...]:
    """Return the finding on strings that are missed because they do not have the given radius.

    If there is no chain, or one is thinner than the given radius, the radius is measured as if none was given. If that
    finds much more string than the chains have, the given radius is wrong. The measurement takes as long as the
    recognition itself.

    Args:
        views: Views that the chains were recognised in.
        scene: Table height and workspace.
        parameters: Parameters for the given radius.
        chains: Recognised chains, perhaps none.
        findings: Findings on the chains.
    """
    if chains and not any(found.code in THINNER for found in findings):
        return ()
    try:
        _, strings = _find_strings(views, scene)
    except RecognitionError:
        strings = ()  # nothing looks like a string of any radius
    if not strings:
        return ()
    radius = _median_radius(strings)
    lengths_m = [arc_length(string.points)[-1] for string in strings]
    recognised_m = sum(chain.length_m for chain in chains)
    if sum(lengths_m) - recognised_m < MIN_MISSED_RADII * radius:
        return ()
    longest = strings[int(np.argmax(lengths_m))].points
    middle = longest[len(longest) // 2]
    found = "no string" if not chains else f"only {recognised_m * 1000:.0f} mm of string"
    message = (
        f"with the radius {parameters.r * 1000:.1f} mm {found} was found, but {sum(lengths_m) * 1000:.0f} mm with a "
        f"measured radius of {radius * 1000:.1f} mm, for example at {format_position(middle)}: recognise the scan "
        "again with this radius, or with none"
    )
    return (finding("string-of-other-radius", message, point=middle, value=radius, limit=parameters.r),)


def _find_strings(views: Sequence[DepthView], scene: Scene) -> tuple[ChainParameters, Sequence[FittedStrand]]:
    """Return parameters for a rough radius, and the strings found with them. Raises as `estimate_parameters`."""
    probe = ChainParameters.for_radius(PROBE_R)
    views = correct_views(views, scene)
    targets = [preprocess(view, probe, scene) for view in views]
    if sum(len(target.points) for target in targets) < MIN_POINTS:
        return ChainParameters.for_radius(PAPER_R), ()
    rough = ChainParameters.for_radius(estimate_rough_radius([target.points for target in targets], scene.table_z_m))
    ingested = ingest_views(views, rough, scene)
    if ingested.no_string_reason is not None:
        return rough, ()
    registration = register(ingested.clouds, rough, ingested.correspondences, table_z_m=scene.table_z_m)
    support = SupportSurface(scene.table_z_m, merge_heights(ingested, registration))
    centre_line = estimate_centre_line(registration.points, registration.normals, rough)
    graph = trace_strands(centre_line.unaveraged, OcclusionMap(registration.points), rough, support.table_z_m)
    bends = graph.pairing.bends
    refinement = refine(graph.strands, registration.points, registration.normals, rough, support, bends=bends)
    return rough, classify_strings(refinement, registration.points, rough, support).strings


def _median_radius(strings: Sequence[FittedStrand]) -> float:
    """Return the length-weighted median of the measured radii, metres."""
    by_radius = sorted(strings, key=lambda string: string.measured_radius_m)
    length = np.cumsum([arc_length(string.points)[-1] for string in by_radius])
    return by_radius[int(np.searchsorted(length, length[-1] / 2))].measured_radius_m


def estimate_rough_radius(clouds: Sequence[NDArray[np.float64]], table_z_m: float) -> float:
    """Estimate the string radius roughly, with an error of up to about a quarter.

    Seen from above, a string is a band. The ridge of the band consists of the cells farthest from both sides. On the
    ridge, the height above the table is 2 r, and the distance from either side is r. Cells with other proportions
    belong to other objects. The height is doubled at crossings, but most of a string lies on the table.

    Args:
        clouds: Points (N, 3) above the table of each view, metres, base frame.
        table_z_m: Height of the table, metres.

    Returns:
        The radius, metres. It is the median of half the height over all ridge cells of strings.

    Raises:
        RadiusUnknownError: No band has the proportions of a string.
    """
    points = np.vstack([np.empty((0, 3)), *clouds])
    points = points[points[:, 2] - table_z_m < MAX_HEIGHT_M]
    if len(points):
        points = points[points[:, 2] - table_z_m > _noise_height(points[:, 2] - table_z_m)]
    if len(points) == 0:
        raise RadiusUnknownError("no string in view, so no radius can be measured: give the radius")
    radii = measure_ridges(points, table_z_m)
    if len(radii) < MIN_RIDGE_CELLS:
        raise RadiusUnknownError(
            "nothing above the table is as high as it is wide, like a string, so no radius can be measured: "
            "give the radius"
        )
    return float(np.median(radii))


def measure_ridges(points: NDArray[np.float64], table_z_m: float) -> NDArray[np.float64]:
    """Return half the height of each ridge cell of a string, seen from above (see `estimate_rough_radius`).

    Args:
        points: (N, 3) points above the table, at least one, metres, base frame.
        table_z_m: Height of the table, metres.

    Returns:
        (K,) half the heights, metres. Each ridge cell is about `CELL_M` of the length of a string.

    Raises:
        RadiusUnknownError: The points spread too far.
    """
    n_points, height = _grid_heights(points, table_z_m)
    band, half_width = _bands(n_points > 0)
    ridge = band & (half_width >= ndimage.maximum_filter(half_width, 3)) & (half_width > CELL_M) & (height > 0)
    radius, width = height[ridge] / 2, half_width[ridge]
    is_string = (radius < MAX_HEIGHT_WIDTH_RATIO * width) & (width < MAX_HEIGHT_WIDTH_RATIO * radius)
    return radius[is_string & (radius > R_MIN) & (radius < R_MAX)]


def _grid_heights(points: NDArray[np.float64], table_z_m: float) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
    """Return the point counts (A, B) and the heights (A, B) above the table of the cells of a horizontal grid."""
    cells = np.floor((points[:, :2] - points[:, :2].min(axis=0)) / CELL_M).astype(np.int64) + 2
    rows, columns = (int(size) for size in cells.max(axis=0) + 3)
    if rows * columns > MAX_CELLS:
        raise RadiusUnknownError(
            f"the points above the table spread over {rows} by {columns} mm, which is too far to measure a radius: "
            "give the radius or a smaller workspace"
        )
    index = cells[:, 0] * columns + cells[:, 1]
    n_points = np.bincount(index, minlength=rows * columns)
    order = np.lexsort((points[:, 2], index))
    # The third highest point of a cell is robust: higher than most noise, and lower than flying pixels.
    last = np.cumsum(n_points) - 1
    third = order[np.maximum(last - np.minimum(2, np.maximum(n_points - 1, 0)), 0)]
    height = np.where(n_points > 0, points[third, 2] - table_z_m, 0.0)
    return n_points.reshape(rows, columns), height.reshape(rows, columns)


def _bands(occupied: NDArray[np.bool_]) -> tuple[NDArray[np.bool_], NDArray[np.float64]]:
    """Return the mask (A, B) of pieces of `MIN_LENGTH_M` or more, and the distances (A, B) from the sides, metres."""
    band = ndimage.binary_closing(occupied, iterations=2)
    half_width = np.asarray(ndimage.distance_transform_edt(band)) * CELL_M
    piece = np.zeros(occupied.shape, dtype=np.int32)
    ndimage.label(band, output=piece)
    extent = [max(part.stop - part.start for part in parts) for parts in ndimage.find_objects(piece) if parts]
    band &= np.concatenate([[False], np.array(extent) * CELL_M >= MIN_LENGTH_M])[piece]
    return band, half_width


def _noise_height(heights: NDArray[np.float64]) -> float:
    """Return the upper limit of the table noise, at which the histogram of `heights` (N,) stops falling, metres."""
    counts, edges = np.histogram(heights, np.arange(float(heights.min()), MAX_HEIGHT_M + 2 * BIN_M, BIN_M))
    smooth = np.convolve(counts, np.ones(3), "valid")
    rising = np.flatnonzero(np.diff(smooth) >= 0)
    return float(edges[rising[0] + 1]) if len(rising) and rising[0] > 0 else -np.inf
