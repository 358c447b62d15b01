"""Position of the table in one view, which checks arm, camera, calibration and mounting together."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.geometry.transforms import inverse, transform_points
from cell.config.cell_config import CellSettings
from cell.devices import View
from recognition.preprocessing.target_cloud import deproject

GRID = 20
"""Number of samples of the workspace's floor in each direction."""
NEAR_M = 0.1
"""Largest distance of the table from its configured height."""
BIN_M = 0.002
"""Bin width of the histogram of heights."""
PASSES_M = (0.02, 0.01, 0.005)
"""Largest distance of a table point from the plane in each pass. The last is a few times the noise of a camera."""
STEP = 4
"""Step between the pixels that are used, in each direction."""
MIN_POINTS = 200
"""Smallest number of points for a plane."""


@dataclass(frozen=True)
class TableFit:
    """Plane of the table in the base frame, measured in one view."""

    height_m: float
    """Height above the configured table, in the middle of the visible part."""
    tilt_rad: float
    """Angle between the plane and the horizontal of the base frame."""
    share: float
    """Share of the points near the configured height that lie on the plane."""


def share_in_view(
    T_base_camera: NDArray[np.float64], K: NDArray[np.float64], size: tuple[int, int], settings: CellSettings
) -> float:
    """Return the share of the workspace's floor that lies within the image, measured or not, 0 to 1.

    Args:
        T_base_camera: Camera pose (4, 4).
        K: Pinhole matrix (3, 3), pixels.
        size: Width and height of the image, pixels.
        settings: Workspace of the cell.
    """
    x_m, y_m, (floor_m, _) = settings.workspace_m
    x, y = np.meshgrid(np.linspace(*x_m, GRID), np.linspace(*y_m, GRID))
    points = transform_points(inverse(T_base_camera), np.column_stack([x.ravel(), y.ravel(), np.full(x.size, floor_m)]))
    pixels = points[points[:, 2] > 0] @ K.T
    pixels = pixels[:, :2] / pixels[:, 2:]
    inside = np.all((pixels >= 0) & (pixels <= np.array(size) - 1), axis=1)
    return float(inside.sum() / len(points))


def fit_table(view: View, settings: CellSettings) -> TableFit | None:
    """Return the plane of most points in the workspace, or None if too few points are near the table."""
    points = _near_table(view, settings)
    if len(points) < MIN_POINTS:
        return None
    # strings rise above the table and shadows lie below it, but most points are on the table
    height = points[:, 2]
    count, edges = np.histogram(height, bins=max(int(np.ptp(height) / BIN_M), 1))
    most = int(count.argmax())
    centre = points[:, :2].mean(axis=0)
    A = np.column_stack([points[:, :2] - centre, np.ones(len(points))])
    plane = np.array([0.0, 0.0, (edges[most] + edges[most + 1]) / 2])
    on_plane = np.zeros(len(points), dtype=bool)
    for width in PASSES_M:
        on_plane = np.abs(height - A @ plane) < width
        if on_plane.sum() < MIN_POINTS / 2:
            return None
        plane = np.linalg.lstsq(A[on_plane], height[on_plane], rcond=None)[0]
    return TableFit(
        height_m=float(plane[2] - settings.mounting.table_z_m),
        tilt_rad=float(np.arctan(np.hypot(plane[0], plane[1]))),
        share=float(on_plane.mean()),
    )


def distance_factor(view: View, settings: CellSettings) -> float:
    """Return the factor on the height error of a view that is taken from farther away than those of a scan.

    An error of the disparities grows with the square of the distance.
    """
    distance_m = float(np.median(view.depth[view.depth > 0])) * view.depth_unit_m
    scan_m = float(np.mean(settings.camera.optics.working_m))
    return max(distance_m / scan_m, 1.0) ** 2


def _near_table(view: View, settings: CellSettings) -> NDArray[np.float64]:
    """Return the points (N, 3) in the workspace's rectangle near the table's height, base frame."""
    rows, columns = np.nonzero(view.depth[::STEP, ::STEP])
    points = deproject(view, STEP * rows, STEP * columns)
    (x0, x1), (y0, y1), (floor, _) = settings.workspace_m
    low, high = np.array([x0, y0, floor - NEAR_M]), np.array([x1, y1, floor + NEAR_M])
    return points[np.all((points >= low) & (points <= high), axis=1)]
