"""Draw strings as tubes into the depth image of a single view, where their bands show their axes.

A string of radius r that rests on the table has its axis at the height r. The image shows where this axis is, so the
surface of the tube is known there. Other parts of the bands, such as crossings, keep their measured profile, raised to
the height of a string.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from recognition.depth_correction.band_axes import across
from recognition.depth_correction.band_gaps import bridge_gaps
from recognition.depth_correction.depth_warp import CorrectedView
from recognition.depth_correction.height_compression import is_wide, raised_depths, with_depths
from recognition.depth_correction.string_bands import StringBands, find_bands
from recognition.preprocessing.target_cloud import AlignedView, DepthView

PIECE_RADII = 1.0
"""Distance on both sides of an axis point up to which its tube is drawn, in radii r."""
STEP_PX = 0.5
"""Step along an axis in which slices of the tube are drawn, pixels."""
MAX_ALONG_PX = 0.8
"""Maximum distance of a pixel from the slice that it belongs to, pixels."""
EDGE = 0.99
"""Distance from the axis up to which a tube is drawn, in radii r. Beyond, it is too steep for one pixel."""
MAX_SAMPLES = 500_000
"""Maximum number of samples of tubes that are drawn at once, which limits the memory."""
UPPER_TOPS = (1.05, 1.4)
"""Height of the tops from which on a string lies partly on another one, and surely, in 2 r."""
MIN_TOP = 0.3
"""Minimum top that is raised to the height of a string, in 2 r."""
BAND_RADII = 2.2
"""Distance from a middle pixel up to which pixels belong to its band, in radii r."""


@dataclass(frozen=True, eq=False)
class DrawnViews:
    """Views of one viewpoint into which the strings were drawn."""

    images: Sequence[DepthView]
    """The views with the drawn strings."""
    compression: float
    """Height of resting strings as a share of 2 r before, the smallest of all views."""
    lost_m: float
    """Height that the lowest tenth of the tops lost, the largest of all views, metres."""


def draw_into_views(views: Sequence[AlignedView], is_matched: bool) -> DrawnViews | None:
    """Draw the strings into all views of one viewpoint.

    Args:
        views: Views aligned to the table plane.
        is_matched: Whether the depth was surely matched in windows. Otherwise, the bands have to show it.

    Returns:
        The drawn views, or None if a view has no bands of strings, or nothing shows that the depth was matched.
    """
    found = [find_bands(aligned) for aligned in views]
    bands = [each for each in found if each is not None]
    n_measuring = sum(aligned.n_measured > 0 for aligned in views)
    if not bands or len(bands) < n_measuring:
        return None
    if not is_matched and not any(each.shows_matching for each in bands):
        return None
    return DrawnViews(
        images=[
            aligned.view if each is None else draw_strings(aligned, each)
            for aligned, each in zip(views, found, strict=True)
        ],
        compression=min(each.compression for each in bands),
        lost_m=max(each.lost_m for each in bands),
    )


def draw_strings(aligned: AlignedView, bands: StringBands) -> CorrectedView:
    """Return the view with tubes of radius r where the bands show axes of strings.

    The table beside the strings is evened, because it shares the slow errors of the depth with them.

    Args:
        aligned: View aligned to the table plane.
        bands: Bands of strings in the view.
    """
    depth_m = raised_depths(aligned, _lost_heights(aligned, bands) - bands.local_table)
    tubes_m = _tube_depths(aligned, bridge_gaps(bands))
    # what is nearer than the tube by its radius is another object
    is_tube = np.isfinite(tubes_m) & (aligned.view.depth > 0) & (tubes_m - depth_m < aligned.parameters.r)
    depth_m[is_tube] = tubes_m[is_tube]
    return with_depths(aligned.view, depth_m)


def _lost_heights(aligned: AlignedView, bands: StringBands) -> NDArray[np.float32]:
    """Return the height (H, W) that each pixel lost, metres. The tops beside it show how much a band lost."""
    diameter_m = bands.diameter_m
    top_m = np.full(bands.heights.shape, np.float32(diameter_m * bands.compression))
    v, u = np.nonzero(bands.mask)
    distance, nearest = bands.tree.query(np.column_stack([u, v]), distance_upper_bound=BAND_RADII * bands.r_px)
    in_band = np.isfinite(distance)
    v = v[in_band]
    u = u[in_band]
    top_m[v, u] = bands.tops_m[np.asarray(nearest)[in_band]]
    is_band = np.zeros(top_m.shape, dtype=np.bool_)
    is_band[v, u] = True
    top_m = np.maximum(top_m, np.float32(MIN_TOP * diameter_m))
    lost = np.clip(bands.heights / top_m, 0, 1) * (_full_tops(bands, top_m) - top_m)
    return np.where(is_band | ~is_wide(aligned, bands.heights), lost, np.float32(0)).astype(np.float32)


def _tube_depths(aligned: AlignedView, bands: StringBands) -> NDArray[np.float64]:
    """Return the depth (H, W) of the nearest tube at each pixel, metres; infinite where there is none."""
    view = aligned.view
    rise = aligned.T_base_camera[2, :3] @ np.linalg.inv(view.K)
    camera_m = aligned.T_base_camera[2, 3] - aligned.scene.table_z_m
    axis_depth_m = _depth_at(bands.axis, _axis_heights(bands, bands.axis_tops_m) - camera_m, rise)
    tube_px = aligned.parameters.r * view.K[0, 0] / axis_depth_m
    half_px = PIECE_RADII * float(np.median(tube_px))
    along_px = np.arange(-half_px, half_px + STEP_PX / 2, STEP_PX)
    across_radii = np.linspace(-1, 1, 2 * int(np.ceil(2 * tube_px.max())) + 3)
    nearest_m = np.full(view.depth.shape, np.inf)
    step = max(MAX_SAMPLES // (len(along_px) * len(across_radii)), 1)
    for first in range(0, len(bands.axis), step):
        piece = slice(first, first + step)
        centre, tangent = _pieces(bands, piece, along_px)
        tops_m = bands.axis_tops_m[piece, None] + along_px * bands.axis_slopes[piece, None]
        depth_m = _depth_at(centre, _axis_heights(bands, tops_m) - camera_m, rise)
        _draw_slices(nearest_m, centre, tangent, depth_m, tube_px[piece], across_radii, aligned.parameters.r)
    return nearest_m


def _pieces(
    bands: StringBands, piece: slice, along_px: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return positions (M, S, 2) and unit tangents (M, S, 2) of the axes at S distances along from M axis points."""
    start = bands.axis[piece, None]
    tangent = bands.tangent[piece, None]
    normal = bands.normal[piece, None]
    bend = (bands.curvature[piece, None] * along_px)[..., None]
    s = along_px[:, None]
    bent = tangent + 2 * bend * normal
    return start + s * tangent + s * bend * normal, bent / np.linalg.norm(bent, axis=-1, keepdims=True)


def _draw_slices(
    nearest_m: NDArray[np.float64],
    centre: NDArray[np.float64],
    tangent: NDArray[np.float64],
    depth_m: NDArray[np.float64],
    tube_px: NDArray[np.float64],
    across_radii: NDArray[np.float64],
    r: float,
) -> None:
    """Draw slices of tubes into an image (H, W) of depths, where they are nearer.

    Args:
        nearest_m: (H, W) depths, metres. They are changed.
        centre: (M, S, 2) positions on the axes, pixels.
        tangent: (M, S, 2) unit vectors along the axes.
        depth_m: (M, S) depths of the axes, metres.
        tube_px: (M,) radii in the image, pixels.
        across_radii: (X,) distances across an axis at which pixels are drawn, in radii.
        r: Radius of the tubes, metres.
    """
    sideways = across(tangent)[:, :, None]
    pixels = np.rint(centre[:, :, None] + (across_radii * tube_px[:, None])[:, None, :, None] * sideways)
    offset = pixels - centre[:, :, None]
    x = (offset * sideways).sum(axis=-1) / tube_px[:, None, None]
    along = np.abs((offset * tangent[:, :, None]).sum(axis=-1))
    height, width = nearest_m.shape
    u, v = np.moveaxis(pixels, -1, 0)
    is_drawn = (np.abs(x) < EDGE) & (along < MAX_ALONG_PX) & (u >= 0) & (u < width) & (v >= 0) & (v < height)
    surface_m = depth_m[:, :, None] - r * np.sqrt(np.maximum(1 - x**2, 0))
    drawn = (v[is_drawn].astype(np.intp), u[is_drawn].astype(np.intp))
    np.minimum.at(nearest_m, drawn, surface_m[is_drawn])


def _axis_heights(bands: StringBands, tops_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the heights (...) of the axes of strings with measured tops (...) above the table, metres."""
    return _full_tops(bands, tops_m) - bands.diameter_m / 2


def _full_tops(bands: StringBands, tops_m: NDArray[np.floating[Any]]) -> NDArray[np.float64]:
    """Return the heights (...) of tops that were measured (...) above the table, metres.

    A string is at least as high as a resting one. One on another string lost as much as a resting one.
    """
    lowest, highest = UPPER_TOPS
    share_on_another = np.clip((tops_m / bands.diameter_m - lowest) / (highest - lowest), 0, 1)
    lost_m = bands.diameter_m * (1 - bands.compression)
    return np.maximum(tops_m + share_on_another * lost_m, bands.diameter_m)


def _depth_at(
    pixels: NDArray[np.float64], descended_m: NDArray[np.float64], rise: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the depth (...) at which the lines of sight of pixels (..., 2) have descended so far, metres.

    `rise` (3,) times (u, v, 1) is the rise of a line of sight per metre of depth.
    """
    return descended_m / (pixels @ rise[:2] + rise[2])
