"""Lines of sight: which views look through a point, and which stop at a string there."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from recognition.preprocessing.flying_pixels import DepthImage
from recognition.preprocessing.normals import NormalCloud
from recognition.preprocessing.target_cloud import TargetCloud

Points = NDArray[np.float64]

BEHIND_RADII = 0.5
"""Minimum distance of the measured point behind the axis, along the optical axis, in radii.

The surface of a string is 1 radius or more before its axis, and the table 1 radius or more behind it.
"""
BEFORE_RADII = 2.5
"""Distance before the axis, along the optical axis, up to which a measured point may lie on the string, in radii."""
MIN_VIEWS = 3
"""Minimum number of views that look through a free point. Two views may be wrong at the same few pixels."""


@dataclass(frozen=True, eq=False)
class ViewCounts:
    """Numbers of views whose lines of sight to N points end behind the points, or at a string there.

    Views in which another object hides the point, or which measured no depth there, count in neither number.
    """

    through: NDArray[np.int64]
    """(N,) number of views that look through the point: their line of sight ends behind it."""
    stopped: NDArray[np.int64]
    """(N,) number of views whose line of sight ends where a string with its axis at the point would stop it."""
    views: int
    """Number of views with a depth image."""

    @property
    def is_free(self) -> NDArray[np.bool_]:
        """(N,) mask of the points at which no string is: half of the views look through them, and at least `MIN_VIEWS`.

        Views along a string cannot look through a short gap, so they do not show that there is none.
        """
        return (self.through >= MIN_VIEWS) & (self.through >= self.stopped)


@dataclass(frozen=True, eq=False)
class PointDepths:
    """Depths along the optical axis of N points, and of what an image shows there."""

    own_m: NDArray[np.float64]
    """(N,) depth of each point, metres; negative behind the camera."""
    measured_m: NDArray[np.float64]
    """(N,) depth measured in the nearest pixel, metres; 0 if nothing was measured, or outside the image."""


def count_views(points: Points, r: float, views: Sequence[NormalCloud | TargetCloud]) -> ViewCounts:
    """Count the views that look through each point, and those that a string with its axis there may have stopped.

    Args:
        points: (N, 3) points, metres, base frame.
        r: Radius of the string, metres.
        views: Registered views. Views without a depth image do not count.
    """
    through, stopped = np.zeros((2, len(points)), dtype=np.int64)
    count = 0
    for view in views:
        if view.image is None or view.T_base_camera is None:
            continue
        count += 1
        depths = depths_at(points, view.image, view.T_base_camera)
        is_measured = depths.measured_m > 0
        behind = depths.measured_m - depths.own_m
        is_through = is_measured & (behind > BEHIND_RADII * r)
        through += is_through
        stopped += is_measured & ~is_through & (behind > -BEFORE_RADII * r)
    return ViewCounts(through, stopped, count)


def depths_at(points: Points, image: DepthImage, T_base_camera: NDArray[np.float64]) -> PointDepths:
    """Return the depths of points, and the depths that an image has in the pixels nearest to them.

    Args:
        points: (N, 3) points, metres, base frame.
        image: Depth image.
        T_base_camera: (4, 4) camera pose, metres.
    """
    in_camera = (points - T_base_camera[:3, 3]) @ T_base_camera[:3, :3]
    is_ahead = in_camera[:, 2] > 0
    pixels = in_camera @ image.K.T
    columns, rows = np.rint(pixels[:, :2] / np.where(is_ahead, pixels[:, 2], 1.0)[:, None]).astype(np.int64).T
    height, width = image.depth.shape
    is_inside = is_ahead & (columns >= 0) & (columns < width) & (rows >= 0) & (rows < height)
    measured_m = np.zeros(len(points))
    measured_m[is_inside] = image.depth[rows[is_inside], columns[is_inside]] * image.depth_unit_m
    return PointDepths(own_m=in_camera[:, 2], measured_m=measured_m)
