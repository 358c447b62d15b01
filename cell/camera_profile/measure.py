"""Measure the profile of a depth camera on a flat table."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cell.camera.frame_averaging import median
from cell.camera_profile.correlation import correlation_length_px
from cell.camera_profile.depth_profile import DepthProfile, ProfileError
from cell.camera_profile.surface_fit import INLIER_SIGMAS, SurfaceFit, TableImage, fit_surfaces
from cell.camera_profile.table_pixels import TablePixels, find_table
from recognition.depth_correction.pixel_locking import PixelLocking
from recognition.preprocessing.plane_fit import median_sigma

EDGE_RING_PX = 8
"""Width of the ring at the edges of objects in which pixels get lost."""
CLOSING_PX = 31
"""Width of the largest hole that counts as a hole in the table. Larger ones may be the end of the table."""
MIN_TABLE_PIXELS = 5000
"""Smallest number of pixels on the table in a pose."""
MIN_EDGE_PIXELS = 500
"""Smallest number of edge pixels for a share of holes."""
STEADY_QUANTILE = 0.98
"""Share of the pixels that count for the temporal noise. The others change between right and wrong matches."""


@dataclass(frozen=True, eq=False)
class PoseImages:
    """Depth images from one pose."""

    depth: NDArray[np.uint16]
    """Depth images (N, H, W) in depth units; 0 = not measured. An image may be the median of several exposures."""
    depth_unit_m: float
    """Metres per depth count."""
    K: NDArray[np.float64]
    """(3, 3) pinhole matrix, pixels."""


@dataclass(frozen=True, eq=False)
class TablePose:
    """Table that one pose shows."""

    n: NDArray[np.float64]
    """(3,) normal of the table in the camera frame, divided by the distance of the camera, 1/m."""


@dataclass(frozen=True, eq=False)
class SeenTable:
    """A table that a camera sees."""

    pose: TablePose
    """Table in the camera frame."""
    K: NDArray[np.float64]
    """(3, 3) pinhole matrix of the depth image, pixels."""
    size: tuple[int, int]
    """Width and height of the depth image, pixels."""
    depth_unit_m: float
    """Metres per depth count."""
    images: int
    """Number of single exposures."""


@dataclass(frozen=True, eq=False)
class Measurement:
    """Measured profile, and where the table is."""

    profile: DepthProfile
    tables: tuple[TablePose, ...]
    """Table of each pose that shows one, in the order of the poses."""


@dataclass(frozen=True, eq=False)
class _PoseTable:
    """Table of one pose, with what is measured in this pose alone."""

    images: PoseImages
    found: TablePixels
    image: TableImage
    temporal_per_m2: float | None
    """Variance of a pixel's inverse depth over the images, 1/m^2; None with one image."""
    hole_share: float
    flicker_share: float | None
    edge_pixels: int
    edge_holes: float
    """Mean number of edge pixels that an image lacks."""


def measure_profile(poses: Sequence[PoseImages], focal_baseline_px_m: float | None = None) -> Measurement:
    """Return the profile of a camera that looks at a flat table from one or several poses.

    Args:
        poses: Depth images of each pose. Poses that show too little of the table are left out.
        focal_baseline_px_m: Product of focal length and baseline, or None to measure it by the pixel locking.

    Raises:
        ProfileError: No pose shows enough of a table, or the images differ in size.
    """
    if not poses:
        raise ProfileError("there is no depth image: give at least one image of the table")
    if len({pose.depth.shape[1:] for pose in poses}) > 1:
        raise ProfileError("the depth images differ in size: profile the images of one camera mode at a time")
    tables = [table for table in map(_table_of_pose, poses) if table is not None]
    if not tables:
        raise ProfileError(
            f"no image shows a table: a plane must fill a fifth of the image and {MIN_TABLE_PIXELS} pixels; point the "
            "camera at the empty table from its working distance"
        )
    fit = fit_surfaces([table.image for table in tables])
    distance_m = float(np.median(np.concatenate([1 / table.image.inverse_depth for table in tables])))
    profile = _profile(tables, fit, distance_m, focal_baseline_px_m)
    normals = [_plane_normal(plane, table.images) for plane, table in zip(fit.planes, tables, strict=True)]
    return Measurement(profile, tuple(TablePose(n) for n in normals))


def _profile(
    tables: Sequence[_PoseTable], fit: SurfaceFit, distance_m: float, focal_baseline_px_m: float | None
) -> DepthProfile:
    """Return the profile for the fitted tables. Errors of the inverse depth become depths at one distance."""
    per_m = distance_m**2
    ripple = np.concatenate(fit.ripple)
    rest = np.concatenate(fit.rest)
    warp = np.concatenate(fit.warp)
    if focal_baseline_px_m is None and fit.locking is not None:
        focal_baseline_px_m = 1 / fit.locking.period_per_m
    temporal = [table.temporal_per_m2 for table in tables if table.temporal_per_m2 is not None]
    flicker = [table.flicker_share for table in tables if table.flicker_share is not None]
    edge_pixels = sum(table.edge_pixels for table in tables)
    errors = [_error_image(table.image, error) for table, error in zip(tables, fit.rest, strict=True)]
    height, width = tables[0].image.shape
    return DepthProfile(
        width=width,
        height=height,
        focal_px=float(tables[0].images.K[0, 0]),
        poses=len(tables),
        exposures=max(len(table.images.depth) for table in tables),
        table_pixels=len(ripple),
        distance_m=distance_m,
        focal_baseline_px_m=focal_baseline_px_m,
        temporal_m=float(np.sqrt(np.mean(temporal))) * per_m if temporal else None,
        ripple_m=median_sigma(ripple) * per_m,
        locking_m=_amplitude(fit.locking) * per_m,
        rest_m=median_sigma(rest) * per_m,
        correlation_px=correlation_length_px(errors, axis=1),
        correlation_rows_px=correlation_length_px(errors, axis=0),
        warp_m=float(np.sqrt(np.mean(warp**2))) * per_m,
        hole_share=float(np.mean([table.hole_share for table in tables])),
        flicker_share=float(np.mean(flicker)) if flicker else None,
        edge_hole_share=_edge_hole_share(tables) if edge_pixels >= MIN_EDGE_PIXELS else None,
    )


def _table_of_pose(pose: PoseImages) -> _PoseTable | None:
    """Return the table of a pose, or None if it shows too little of one."""
    middle_m = median(list(pose.depth)) * pose.depth_unit_m
    found = find_table(middle_m, EDGE_RING_PX)
    if found is None:
        return None
    on_table = found.table & (pose.depth > 0).all(axis=0)
    rows, columns = np.nonzero(on_table)
    if len(rows) < MIN_TABLE_PIXELS:
        return None
    mean, variance = _inverse_depth(pose, on_table)
    height, width = middle_m.shape
    is_table = _closed(found.table | found.inside_objects) & ~found.inside_objects
    within = pose.depth[:, is_table] > 0
    at_edges = pose.depth[:, found.edges] > 0
    return _PoseTable(
        images=pose,
        found=found,
        image=TableImage(mean, rows, columns, (height, width)),
        temporal_per_m2=None if variance is None else _steady_mean(variance),
        hole_share=1 - float(within.mean()),
        flicker_share=float(np.mean(within[1:] != within[:-1])) if len(within) > 1 else None,
        edge_pixels=int(found.edges.sum()),
        edge_holes=float((~at_edges).sum()) / len(at_edges),
    )


def _inverse_depth(
    pose: PoseImages, on_table: NDArray[np.bool_]
) -> tuple[NDArray[np.float64], NDArray[np.float64] | None]:
    """Return the mean inverse depth (N,) of the marked pixels and its variance over the images, or None with one."""
    count = len(pose.depth)
    total = np.zeros(int(on_table.sum()))
    squares = np.zeros(len(total))
    # the differences to the first image are small, so that their squares lose no digits
    first = 1 / (pose.depth[0][on_table] * pose.depth_unit_m)
    for depth in pose.depth:
        difference = 1 / (depth[on_table] * pose.depth_unit_m) - first
        total += difference
        squares += difference**2
    mean = first + total / count
    if count == 1:
        return mean, None
    return mean, np.maximum(squares - total**2 / count, 0.0) / (count - 1)


def _steady_mean(variance: NDArray[np.float64]) -> float:
    """Return the mean of the variances (N,) without the largest ones."""
    return float(variance[variance <= np.quantile(variance, STEADY_QUANTILE)].mean())


def _closed(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return a mask (H, W) without holes that are narrower than `CLOSING_PX`."""
    import cv2

    square = np.ones((CLOSING_PX, CLOSING_PX), dtype=np.uint8)
    return np.asarray(cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_CLOSE, square), dtype=np.bool_)


def _edge_hole_share(tables: Sequence[_PoseTable]) -> float:
    """Return the share of the edge pixels of all poses that are not measured."""
    return sum(table.edge_holes for table in tables) / sum(table.edge_pixels for table in tables)


def _error_image(image: TableImage, error: NDArray[np.float64]) -> NDArray[np.float32]:
    """Return the errors (N,) of a table as an image (H, W), with outliers at the limit and unknown pixels as NaN."""
    limit = INLIER_SIGMAS * median_sigma(error)
    values = np.full(image.shape, np.nan, dtype=np.float32)
    values[image.rows, image.columns] = np.clip(error - np.median(error), -limit, limit)
    return values


def _amplitude(locking: PixelLocking | None) -> float:
    """Return the amplitude of a sine with the same mean square as the pixel locking, 1/m."""
    return 0.0 if locking is None else float(np.linalg.norm(locking.coefficients))


def _plane_normal(plane: NDArray[np.float64], images: PoseImages) -> NDArray[np.float64]:
    """Return the normal (3,) of a plane in the camera frame, divided by its distance, 1/m.

    Args:
        plane: (3,) inverse depth as factors of `image_positions`, 1/m.
        images: Images of the pose.
    """
    height, width = images.depth.shape[1:]
    by_pixel = np.array([plane[0] / width, plane[1] / height, plane[2] - plane[0] / 2 - plane[1] / 2])
    # the inverse depth is n . K^-1 (u, v, 1)
    return np.asarray(images.K.T @ by_pixel, dtype=np.float64)
