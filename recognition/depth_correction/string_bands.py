"""Bands of strings in one depth image of a stereo camera, and the axes of the bands.

Matching windows keep the position of a string across, but not its height: it changes along the string by up to half of
the diameter. Several views average that. In a single view, only the band that the string covers in the image is left.
Its middle shows the axis of the string.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import KDTree

from recognition.depth_correction.band_axes import MIN_MIDDLES, PixelPairs, across, fit_axes
from recognition.depth_correction.height_compression import (
    APEX_RADII,
    BLUR_RADII,
    HALF_HEIGHT,
    MAX_RESTING,
    MIN_BLUR_PX,
    MIN_COMPRESSION,
    MIN_LOSS,
    MIN_SLOPE,
    PIXEL_EDGE_PX,
)
from recognition.depth_correction.pixel_heights import heights_above_table
from recognition.preprocessing.target_cloud import AlignedView, is_in_workspace

LOCAL_RADII = 8.0
"""Standard deviation of the weights with which the table beside a pixel is averaged, in radii r. Slow errors of the
depth are the same on a string and on the table beside it."""
LOCAL_STEP_RADII = 1.0
"""Step of the pixels whose heights are averaged for that, in radii r."""
LOCAL_TRUNCATE = 2.5
"""Distance up to which they are averaged, in standard deviations."""
TABLE_SCATTERS = 3.0
"""Maximum height of the pixels that are averaged, in standard deviations of patches of the table, or `TABLE_RADII`."""
TABLE_RADII = 0.5
"""The same maximum in radii r, if that is more."""
MIN_TABLE_SHARE = 0.05
"""Minimum weight of the table in this average. With less, the table counts as even."""
MIN_HEIGHT_RADII = 0.35
"""Minimum height of a band above the table beside it, in radii r."""
MIN_HEIGHT_SCATTERS = 2.5
"""Minimum height of a band, in standard deviations of patches of the table."""
MAX_MIDDLES = 10_000
"""Maximum number of middle pixels of an image. Ten metres of string have about 3,000; more are noise."""
SPAN_RADII = 3.0
"""Distance from a middle pixel up to which others determine its axis, in radii r."""
WIDTH_RADII = (0.5, 1.6)
"""Smallest and largest half width of a band along an axis, in radii r."""
MIN_MEDIAN_WIDTH_RADII = 0.75
"""Minimum median half width of the bands of a region, in radii r. Narrower bands are those of thinner strings."""
MIN_AXIS_POINTS = 10
"""Minimum number of axis points of a region, and of an image."""
FULL_HEIGHT = 0.8
"""Minimum height of a top of a string, as a share of that of resting strings."""
MIN_FULL_SHARE = 0.3
"""Minimum share of tops of this height in a region. Other regions are lower objects."""
MAX_TOP_SHARE = 0.3
"""Maximum height of a top, as a share of the height of the camera above the table. Higher ones are wrong depth."""
MAX_ACROSS_TILT = 0.26
"""Maximum rise across an axis, per length, at which its profile is measured: 15 degrees. In a more oblique view, the
near side of a string is a wide flank."""
PROFILE_RADII = 2.4
"""Distance from the axis up to which the mean profile of the bands is measured, in radii r."""
PROFILE_STEP_RADII = 0.1
"""Step of this profile, in radii r."""
FLANK_HEIGHTS = (0.75, 0.25)
"""Heights between which the width of the flank of the profile is measured, as shares of its height."""
MIN_BORDER_BLUR_PX = 1.4
"""Minimum blur of the borders of strings that shows that depth was matched in windows, pixels. Windows of 5 pixels blur
them by 1.7 or more in most views; depth without windows by up to 0.8."""
LOWEST_PERCENTILE = 10
"""Percentile of the tops that stands for the lowest ones. Single ones are wrong depth."""
LOW_TOP = 0.8
"""Height below which the top of a band is too low for a string, in 2 r."""
LOW_WIDTH_RADII = 0.85
"""Minimum half width of a band that is not that of a thinner string, in radii r."""
HIGH_TOPS = (0.9, 1.5)
"""Heights between which the top of a band is high enough for a string on the table, in 2 r. Higher parts do not lie on
it."""
MIN_LOW_SHARE = 0.05
"""Minimum share of low tops in a region whose heights are uneven."""
MIN_HIGH_SHARE = 0.5
"""Minimum share of high tops in such a region. A low object is low everywhere."""
ROUND_FLANK_RADII = 0.134
"""Width of the flank of a round string, in radii r: it falls from 0.75 to 0.25 of its height from 0.87 r to r."""


@dataclass(frozen=True, eq=False)
class StringBands:
    """Bands of an image that are as wide as strings. Positions are in pixels (u, v), heights above the table beside."""

    heights: NDArray[np.float32]
    """(H, W) heights, metres; 0 where nothing is measured."""
    local_table: NDArray[np.float32]
    """(H, W) height of the table beside each pixel above the table plane, metres."""
    mask: NDArray[np.bool_]
    """(H, W) pixels that are higher than the table."""
    middles: NDArray[np.float64]
    """(N, 2) middle pixels of the bands of strings."""
    tops_m: NDArray[np.float64]
    """(N,) median height of the tops beside a middle pixel along the band, metres."""
    axis: NDArray[np.float64]
    """(M, 2) points of the axes, where they are smooth."""
    tangent: NDArray[np.float64]
    """(M, 2) unit vectors along the axes."""
    curvature: NDArray[np.float64]
    """(M,) half the curvature of the axes, to the left of `tangent` seen in the image, 1/pixel."""
    across_rise: NDArray[np.float64]
    """(M,) rise of the image plane along `normal`, per length; 0 if a string is seen from straight above."""
    axis_tops_m: NDArray[np.float64]
    """(M,) heights of the tops at these points, metres."""
    axis_slopes: NDArray[np.float64]
    """(M,) rise of the tops along `tangent`, metres per pixel."""
    compression: float
    """Height of resting strings as a share of 2 r; 1 if they have their full height."""
    is_uneven: bool
    """Whether a string is too low in places: parts of a region are lower than a string of their width can be."""
    diameter_m: float
    """Diameter of a string, metres."""
    r_px: float
    """Radius of a string at the usual depth, pixels."""

    @property
    def normal(self) -> NDArray[np.float64]:
        """(M, 2) unit vectors across the axes."""
        return across(self.tangent)

    @cached_property
    def tree(self) -> KDTree:
        """k-d tree of the middle pixels, built at the first access."""
        return KDTree(self.middles)

    @property
    def lost_m(self) -> float:
        """Height that the lowest tenth of the tops lost at least, metres."""
        return max(self.diameter_m - float(np.percentile(self.axis_tops_m, LOWEST_PERCENTILE)), 0.0)

    @property
    def shows_matching(self) -> bool:
        """Whether the bands show that the depth was matched in windows."""
        return self.is_uneven or self.border_blur_px() >= MIN_BORDER_BLUR_PX

    def border_blur_px(self) -> float:
        """Return how far the borders of resting strings are blurred, pixels; 0 if too little shows it.

        Windows blur a border over about half their width. Sharp pixels blur it by less than one.
        """
        is_level = np.abs(self.across_rise) < MAX_ACROSS_TILT
        shown = is_level & (self.axis_tops_m < MAX_RESTING * self.diameter_m)
        if np.count_nonzero(shown) < MIN_AXIS_POINTS:
            return 0.0
        offsets = np.arange(-PROFILE_RADII, PROFILE_RADII + PROFILE_STEP_RADII / 2, PROFILE_STEP_RADII)
        across_px = offsets[:, None] * self.r_px * self.normal[shown, None]
        u, v = np.moveaxis(self.axis[shown, None] + across_px, -1, 0)
        sampled = ndimage.map_coordinates(self.heights, [v, u], order=1, mode="nearest")
        profile = np.median(sampled / self.axis_tops_m[shown, None], axis=0)
        high, low = (_half_width(profile, share * float(profile.max())) for share in FLANK_HEIGHTS)
        if low is None or high is None:
            return 0.0
        return float((low - high) * PROFILE_STEP_RADII - ROUND_FLANK_RADII) * self.r_px


def find_bands(aligned: AlignedView) -> StringBands | None:
    """Return the bands of strings in a view, or None if there are none.

    Args:
        aligned: View aligned to the table plane.
    """
    r = aligned.parameters.r
    r_px = r * aligned.pixels_per_m
    patch_m = aligned.scatter.patch_m or 0.0
    above_plane = heights_above_table(aligned, 1)
    local_table = _local_table(above_plane, r_px, max(TABLE_RADII * r, TABLE_SCATTERS * patch_m))
    heights = np.where(above_plane != 0, above_plane - local_table, np.float32(0))

    smooth = ndimage.gaussian_filter(heights, max(BLUR_RADII * r_px, MIN_BLUR_PX), truncate=3.0)
    mask = smooth > max(MIN_HEIGHT_RADII * r, MIN_HEIGHT_SCATTERS * patch_m)
    top = ndimage.maximum_filter(smooth, 2 * round(r_px) + 1)
    half_width = np.asarray(ndimage.distance_transform_edt(mask & (smooth > HALF_HEIGHT * top)), dtype=np.float32)
    is_middle = half_width >= ndimage.maximum_filter(half_width, 3)
    v, u = np.nonzero(is_middle & (half_width > max(1.0, PIXEL_EDGE_PX + WIDTH_RADII[0] * r_px)))
    if not MIN_MIDDLES <= len(v) <= MAX_MIDDLES:
        return None
    middles = np.column_stack([u, v]).astype(np.float64)
    apex = ndimage.maximum_filter(smooth, 2 * round(APEX_RADII * r_px) + 1)[v, u].astype(np.float64)
    width = np.asarray((half_width[v, u] - PIXEL_EDGE_PX) / r_px, dtype=np.float64)
    pairs = PixelPairs.within(middles, SPAN_RADII * r_px)
    tops_m = pairs.median(apex)
    median_width = pairs.median(width)
    axes = fit_axes(middles, pairs, SPAN_RADII * r_px)
    narrowest, widest = WIDTH_RADII
    is_wide_enough = (median_width > narrowest) & (median_width < widest) & _are_in_workspace(aligned, middles, tops_m)
    is_smooth = axes.is_smooth(r_px) & is_wide_enough

    regions = _regions(mask)[v, u]
    compression = _compression(regions[is_smooth], tops_m[is_smooth] / (2 * r))
    in_string = _are_strings(regions, is_smooth, tops_m > FULL_HEIGHT * compression * 2 * r, median_width)
    is_axis = is_smooth & in_string
    is_uneven = _is_uneven(regions[is_axis], tops_m[is_axis] / (2 * r), median_width[is_axis])
    if np.count_nonzero(is_axis) < MIN_AXIS_POINTS:
        return None
    in_band = in_string & is_wide_enough
    tangent = axes.tangent[is_axis]
    across_rise = across(tangent) @ aligned.T_base_camera[2, :2]
    # from the side, the lower half of a string is in its band on the near side only
    middle_px = np.sign(across_rise) * r_px * (1 - np.sqrt(1 - across_rise**2)) / 2
    return StringBands(
        heights=heights,
        local_table=local_table,
        mask=mask,
        middles=middles[in_band],
        tops_m=tops_m[in_band],
        axis=axes.position[is_axis] - middle_px[:, None] * across(tangent),
        tangent=tangent,
        across_rise=across_rise,
        curvature=axes.curvature[is_axis],
        axis_tops_m=tops_m[is_axis],
        axis_slopes=axes.slope_of(tops_m, pairs)[is_axis],
        compression=compression,
        is_uneven=is_uneven,
        diameter_m=2 * r,
        r_px=r_px,
    )


def _local_table(above_plane: NDArray[np.float32], r_px: float, limit_m: float) -> NDArray[np.float32]:
    """Return the mean height (H, W) of the table beside each pixel above the plane, metres; 0 far from the table."""
    step = max(int(LOCAL_STEP_RADII * r_px), 1)
    sampled = above_plane[::step, ::step]
    is_table = (sampled != 0) & (np.abs(sampled) < limit_m)
    sigma = LOCAL_RADII * r_px / step
    weight = ndimage.gaussian_filter(is_table.astype(np.float32), sigma, truncate=LOCAL_TRUNCATE)
    height = ndimage.gaussian_filter(np.where(is_table, sampled, np.float32(0)), sigma, truncate=LOCAL_TRUNCATE)
    is_known = weight > MIN_TABLE_SHARE
    mean = np.where(is_known, height / np.where(is_known, weight, np.float32(1)), np.float32(0))
    height_px, width_px = above_plane.shape
    return np.repeat(np.repeat(mean, step, axis=0), step, axis=1)[:height_px, :width_px]


def _are_in_workspace(
    aligned: AlignedView, pixels: NDArray[np.float64], height_m: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """Return which pixels (N, 2) with heights (N,) above the table, metres, are in the workspace and not too high."""
    T = aligned.T_base_camera
    camera_height_m = T[2, 3] - aligned.scene.table_z_m
    rays = np.column_stack([pixels, np.ones(len(pixels))]) @ (T[:3, :3] @ np.linalg.inv(aligned.view.K)).T
    descent = np.maximum(-rays[:, 2], MIN_SLOPE)
    points = T[:3, 3] + rays * ((camera_height_m - height_m) / descent)[:, None]
    is_seen = (-rays[:, 2] > MIN_SLOPE) & (height_m < MAX_TOP_SHARE * camera_height_m)
    return is_seen & is_in_workspace(points, aligned.scene)


def _regions(mask: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Return the number (H, W) of the connected region of each pixel of a mask, also across corners; 0 outside."""
    labels = np.zeros(mask.shape, dtype=np.intp)
    ndimage.label(mask, np.ones((3, 3)), output=labels)
    return labels


def _compression(regions: NDArray[np.intp], tops: NDArray[np.float64]) -> float:
    """Return the compression of heights from the tops (N,) in 2 r of axes in regions (N,); 1 if there is none.

    It is the median of the resting tops in the highest region. Lower regions are those of lower objects.
    """
    is_resting = tops < MAX_RESTING
    medians = [
        float(np.median(tops[is_resting & (regions == region)]))
        for region in np.unique(regions)
        if np.count_nonzero(is_resting & (regions == region)) >= MIN_AXIS_POINTS
    ]
    compression = max(medians, default=1.0)
    return 1.0 if compression > 1 - MIN_LOSS else max(compression, MIN_COMPRESSION)


def _are_strings(
    regions: NDArray[np.intp],
    is_smooth: NDArray[np.bool_],
    is_full: NDArray[np.bool_],
    width: NDArray[np.float64],
) -> NDArray[np.bool_]:
    """Return which middle pixels (N,) are in a region of strings.

    Args:
        regions: (N,) number of the connected region of each middle pixel.
        is_smooth: (N,) whether it has a smooth axis.
        is_full: (N,) whether its top is as high as a string.
        width: (N,) half width of the band, in radii.
    """
    is_string = np.zeros(len(regions), dtype=np.bool_)
    for region in np.unique(regions[is_smooth]):
        members = is_smooth & (regions == region)
        number = np.count_nonzero(members)
        is_high = np.count_nonzero(members & is_full) > MIN_FULL_SHARE * number
        if number >= MIN_MIDDLES and is_high and np.median(width[members]) >= MIN_MEDIAN_WIDTH_RADII:
            is_string |= regions == region
    return is_string


def _is_uneven(regions: NDArray[np.intp], tops: NDArray[np.float64], width: NDArray[np.float64]) -> bool:
    """Return whether a region (N,) has tops (N,) in 2 r too low for a string, and others high enough."""
    lowest_high, highest = HIGH_TOPS
    is_low = (tops < LOW_TOP) & (width > LOW_WIDTH_RADII)
    for region in np.unique(regions):
        members = (regions == region) & (tops < highest)
        if np.count_nonzero(members) < MIN_AXIS_POINTS:
            continue
        low_share = float(np.mean(is_low[members]))
        high_share = float(np.mean(tops[members] >= lowest_high))
        if low_share > MIN_LOW_SHARE and high_share > MIN_HIGH_SHARE:
            return True
    return False


def _half_width(profile: NDArray[np.float64], level: float) -> float | None:
    """Return half the number of steps over which the middle of a profile (K,) is above a level, or None for all."""
    middle = len(profile) // 2
    below = np.flatnonzero(profile <= level)
    left = below[below < middle]
    right = below[below > middle]
    if len(left) == 0 or len(right) == 0:
        return None
    return float(right[0] - left[-1]) / 2
