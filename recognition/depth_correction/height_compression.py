"""Compression of heights by the matching windows of a stereo camera: measure it on strings, and restore heights.

A stereo camera compares windows of several pixels. A window on a string that is not much wider also contains table, so
the string is measured too low and its sides too flat. The width at half its height hardly changes. The compression is
the measured height of the ridge of a resting string, as a share of 2 r. A window loses the same height on a string that
lies on another string, because it then contains the lower string instead of the table.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import KDTree

from calibration.geometry.transforms import transform_points
from recognition.depth_correction.depth_warp import MAX_COUNT, CorrectedView, finer_unit_m
from recognition.depth_correction.pixel_heights import heights_above_table, slopes
from recognition.preprocessing.target_cloud import AlignedView, DepthView, deproject, intensity_of, is_in_workspace

MIN_HEIGHT_RADII = 0.5
"""Minimum height of a ridge above the table, in radii r."""
MIN_HEIGHT_SCATTERS = 3.0
"""Minimum height of a ridge above the table, in standard deviations of patches of the table."""
PIXELS_PER_RADIUS = 2.5
"""Minimum number of pixels per radius r after even subsampling of an image."""
BLUR_RADII = 0.2
"""Standard deviation of the blur of the heights before ridges are searched, in radii r."""
MIN_BLUR_PX = 0.4
"""Minimum standard deviation of this blur, pixels."""
HALF_HEIGHT = 0.5
"""Height at which the width of a string is measured, as a share of its height."""
APEX_RADII = 0.5
"""Maximum distance of the highest pixel from the middle of the string, in radii r. In an oblique view, the highest line
of a string is not in the middle of its band."""
PIXEL_EDGE_PX = 0.25
"""Mean excess of the distance to the nearest pixel beside a band over half its width, pixels. It is 0 for an even width
and 0.5 for an odd one."""
WIDTH_RADII = (0.6, 1.5)
"""Smallest and largest half width of a string of radius r at half its height, in radii r."""
MIN_OTHER_VIEWS_SHARE = 0.6
"""Minimum share of the other views that show a ridge at the same place. Ripples of the table are elsewhere in each."""
MAX_CONFIRMED = 100
"""Maximum number of ridge pixels of a view that are searched in the others, evenly spread."""
MIN_RIDGES = 40
"""Minimum number of ridge pixels, over all views, from which the compression is measured."""
HEIGHT_BIN = 0.01
"""Width of the bins of the density of ridge heights, in 2 r."""
MAX_HEIGHT = 2.6
"""Maximum ridge height, in 2 r: more than that of a string on another string."""
BANDWIDTH = 0.05
"""Standard deviation of the kernel of the density of ridge heights, in 2 r."""
MAX_RESTING = 1.05
"""Maximum height of the peak of resting strings in the density, in 2 r. Higher peaks are those of strings that lie on
others, which can be most of a knot."""
MAX_COMPARED = 1.4
"""The same limit if r may be too small by a quarter."""
PEAK_SHARE = 0.25
"""Minimum density of this peak, as a share of the densest one below the limit.

The highest such peak counts. Windows compress all resting strings alike, so lower peaks are those of other objects.
"""
MIN_LOSS = 0.08
"""Minimum loss of height, as a share. Less is not worth the time, and the fit of the tube adds it."""
MIN_COMPRESSION = 0.4
"""Minimum compression. A lower string is that of another radius."""
MAX_CHANGE = 0.03
"""Maximum change of the compression for which views are not preprocessed again."""
WIDTH_WEIGHT = 0.6
"""Weight of the width in the geometric mean of height and width that gives the radius."""
WIDE_RADII = 4.0
"""Half width beyond which windows do not compress an object, in radii r."""
WIDE_MARGIN = 2.0
"""Distance from the core of a wide object within which it is not compressed, in its minimum half width."""
MIN_SLOPE = 0.1
"""Minimum descent of a line of sight per metre of depth, for which heights are restored."""


@dataclass(frozen=True, eq=False)
class Ridges:
    """Middle pixels of the bands in one view that are as wide as a string."""

    xy: NDArray[np.float64]
    """(N, 2) positions on the table, metres, base frame."""
    height: NDArray[np.float64]
    """(N,) heights of the highest pixels beside them above the table, in 2 r."""
    half_width: NDArray[np.float64]
    """(N,) half widths of the bands at half their height, in r."""

    @cached_property
    def tree(self) -> KDTree:
        """k-d tree of the positions, built at the first access."""
        return KDTree(self.xy)


def find_ridges(aligned: AlignedView) -> Ridges:
    """Return the ridges of a view.

    Args:
        aligned: View aligned to the table plane.
    """
    parameters = aligned.parameters
    stride = max(int(parameters.r * aligned.pixels_per_m / PIXELS_PER_RADIUS), 1)
    r_px = parameters.r * aligned.pixels_per_m / stride
    heights = heights_above_table(aligned, stride)
    lowest_m = _lowest_height(aligned)
    area = _bounding_box(heights > lowest_m, 2 * r_px)
    if area is None:
        return Ridges(np.zeros((0, 2)), np.zeros(0), np.zeros(0))
    heights = heights[area]
    smooth = ndimage.gaussian_filter(heights, max(BLUR_RADII * r_px, MIN_BLUR_PX), truncate=3.0)
    top = ndimage.maximum_filter(smooth, 2 * round(r_px) + 1)
    half_width = ndimage.distance_transform_edt(heights > np.maximum(HALF_HEIGHT * top, lowest_m))
    half_width = np.asarray(half_width, dtype=np.float32)
    is_middle = (half_width > 1) & (half_width >= ndimage.maximum_filter(half_width, 3))
    width = (half_width[is_middle] - PIXEL_EDGE_PX) / r_px
    apex = ndimage.maximum_filter(smooth, 2 * round(APEX_RADII * r_px) + 1)[is_middle]
    narrowest, widest = WIDTH_RADII
    is_string = (width > narrowest) & (width < widest)
    v, u = (index[is_string] for index in np.nonzero(is_middle))
    rows = (v + area[0].start) * stride
    columns = (u + area[1].start) * stride
    points = transform_points(aligned.T_table_alignment, deproject(aligned.view, rows, columns))
    kept = is_in_workspace(points, aligned.scene)
    return Ridges(
        xy=points[kept, :2],
        height=apex[is_string][kept].astype(np.float64) / (2 * parameters.r),
        half_width=width[is_string][kept].astype(np.float64),
    )


def estimate_compression(views: Sequence[Ridges], r: float) -> float:
    """Return the compression of heights, 1 if there is none or if too little shows it.

    Args:
        views: Ridges of each view.
        r: Radius of the strings, metres.
    """
    confirmed = _confirm(views, r)
    if confirmed is None:
        return 1.0
    compression = _resting_height(confirmed, MAX_RESTING)
    if compression is None or compression > 1 - MIN_LOSS:
        return 1.0
    return max(compression, MIN_COMPRESSION)


def estimate_radius(views: Sequence[Ridges], r: float) -> float | None:
    """Return the radius of the strings from height and width of their bands, metres, or None if too little shows it.

    Windows lower strings and widen them, or hardly change one of both. A mean of half the height and half the width is
    therefore nearer to the radius than either. The width counts more, because strings are missed with a radius that is
    too small.

    Args:
        views: Ridges of each view, for the radius `r`.
        r: Radius that bands are compared with, metres.
    """
    confirmed = _confirm(views, r)
    if confirmed is None:
        return None
    half_width = float(np.median(confirmed.half_width))
    height = _resting_height(confirmed, MAX_COMPARED)
    if height is None:
        return None
    half_height = height * min(half_width, 1.0)
    return r * float(half_height ** (1 - WIDTH_WEIGHT) * half_width**WIDTH_WEIGHT)


def restore_heights(aligned: AlignedView, compression: float) -> CorrectedView:
    """Return the view with restored heights. Each point moves along its line of sight.

    Heights up to that of a resting string are divided by the compression. Higher ones gain as much as a resting string.
    Objects that are much wider than a string keep their heights.

    Args:
        aligned: View aligned to the table plane.
        compression: Compression of heights.
    """
    heights = heights_above_table(aligned, 1)
    lost = np.minimum(heights, np.float32(2 * aligned.parameters.r * compression)) * np.float32(1 / compression - 1)
    is_restored = (heights > 0) & ~is_wide(aligned, heights)
    return with_depths(aligned.view, raised_depths(aligned, np.where(is_restored, lost, np.float32(0))))


def raised_depths(aligned: AlignedView, raised_m: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the depths (H, W) of points that are raised along their lines of sight, metres; 0 stays 0.

    Args:
        aligned: View aligned to the table plane.
        raised_m: (H, W) height by which each point is raised, metres. Nearly level lines of sight are not raised.
    """
    view = aligned.view
    descent = -slopes(aligned, 1)
    is_raised = (view.depth > 0) & (descent > MIN_SLOPE)
    nearer_m = np.where(is_raised, raised_m / np.maximum(descent, MIN_SLOPE), np.float32(0))
    return view.depth * np.float32(view.depth_unit_m) - nearer_m


def with_depths(view: DepthView, depth_m: NDArray[np.float32]) -> CorrectedView:
    """Return a view with other depths (H, W), metres, in a unit so fine that rounding adds no error."""
    unit_m = finer_unit_m(view.depth_unit_m, float(depth_m.max()))
    counts = np.clip(np.rint(depth_m / np.float32(unit_m)), 0, MAX_COUNT)
    return CorrectedView(view.index, counts.astype(np.uint16), unit_m, view.K, view.T_base_camera, intensity_of(view))


def is_wide(aligned: AlignedView, heights: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Return which pixels (H, W) belong to objects that are much wider than a string.

    Args:
        aligned: View aligned to the table plane.
        heights: (H, W) height of each pixel above the table, metres.
    """
    wide_px = WIDE_RADII * aligned.parameters.r * aligned.pixels_per_m
    stride = max(int(wide_px / PIXELS_PER_RADIUS), 1)
    is_high = heights[::stride, ::stride] > _lowest_height(aligned)
    core = np.asarray(ndimage.distance_transform_edt(is_high)) > wide_px / stride
    if not core.any():
        return np.zeros(heights.shape, dtype=np.bool_)
    near = np.asarray(ndimage.distance_transform_edt(~core)) < WIDE_MARGIN * wide_px / stride
    height, width = heights.shape
    return np.repeat(np.repeat(near, stride, axis=0), stride, axis=1)[:height, :width]


@dataclass(frozen=True, eq=False)
class _ConfirmedRidges:
    """Ridge pixels that enough views show at the same place."""

    height: NDArray[np.float64]
    """(N,) heights, relative to that of a string of radius r, or of a thinner one if the band is narrower."""
    half_width: NDArray[np.float64]
    """(N,) half widths of the bands at half their height, in r."""


def _confirm(views: Sequence[Ridges], r: float) -> _ConfirmedRidges | None:
    """Return the ridges that enough views show, each as the mean of these views; None if they are too few."""
    min_views = 1 + MIN_OTHER_VIEWS_SHARE * (len(views) - 1)
    shown = [ridges for ridges in views if len(ridges.xy)]
    heights = [np.zeros(0)]
    half_widths = [np.zeros(0)]
    for ridges in shown:
        step = -(-len(ridges.xy) // MAX_CONFIRMED)
        xy = ridges.xy[::step]
        n_views = np.zeros(len(xy))
        height = np.zeros(len(xy))
        half_width = np.zeros(len(xy))
        for other in shown:
            distance, nearest = other.tree.query(xy, distance_upper_bound=r)
            is_seen = np.isfinite(distance)
            n_views += is_seen
            height[is_seen] += other.height[np.asarray(nearest)[is_seen]]
            half_width[is_seen] += other.half_width[np.asarray(nearest)[is_seen]]
        is_confirmed = n_views >= min_views
        mean_width = half_width / n_views
        relative = height / (n_views * np.minimum(mean_width, 1.0))
        heights.append(relative[is_confirmed])
        half_widths.append(mean_width[is_confirmed])
    confirmed = _ConfirmedRidges(np.concatenate(heights), np.concatenate(half_widths))
    return confirmed if len(confirmed.height) >= MIN_RIDGES else None


def _resting_height(confirmed: _ConfirmedRidges, limit: float) -> float | None:
    """Return the height of resting strings, as heights of ridges are measured, or None if none is below a limit."""
    counts, edges = np.histogram(confirmed.height, np.arange(0.0, MAX_HEIGHT, HEIGHT_BIN))
    density = ndimage.gaussian_filter1d(counts.astype(np.float64), BANDWIDTH / HEIGHT_BIN)
    is_peak = (density[1:-1] >= density[:-2]) & (density[1:-1] > density[2:])
    peaks = np.flatnonzero(is_peak) + 1
    peaks = peaks[edges[peaks] < limit]
    if len(peaks) == 0:
        return None
    resting = peaks[density[peaks] > PEAK_SHARE * density[peaks].max()][-1]
    return float(edges[resting]) + HEIGHT_BIN / 2


def _lowest_height(aligned: AlignedView) -> float:
    """Return the height above the table from which something is an object, metres."""
    return max(MIN_HEIGHT_RADII * aligned.parameters.r, MIN_HEIGHT_SCATTERS * (aligned.scatter.patch_m or 0.0))


def _bounding_box(mask: NDArray[np.bool_], margin_px: float) -> tuple[slice, slice] | None:
    """Return the rows and columns that contain a mask (H, W) with a margin, or None for an empty mask."""
    rows = np.flatnonzero(mask.any(axis=1))
    columns = np.flatnonzero(mask.any(axis=0))
    if len(rows) == 0:
        return None
    margin = int(np.ceil(margin_px))
    return (
        slice(max(int(rows[0]) - margin, 0), int(rows[-1]) + margin + 1),
        slice(max(int(columns[0]) - margin, 0), int(columns[-1]) + margin + 1),
    )
