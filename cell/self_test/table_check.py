"""Whether a view sees the table where the configuration has it: one look that tests arm, camera, calibration and
mounting together."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.geometry.transforms import inverse, transform_points
from cell.config.cell_config import CellSettings
from cell.devices import View
from recognition.preprocessing.target_cloud import deproject

GRID = 20
"""The workspace's floor is asked for at so many places each way."""
NEAR_M = 0.1
"""What lies farther from the configured height is not taken for the table."""
BIN_M = 0.002
PASSES_M = (0.02, 0.01, 0.005)
"""Distances from the plane within which points count as the table's, pass by pass: the last is a few times what a
camera scatters there."""
STEP = 4
"""Every so manieth pixel each way is enough for a plane."""
LEAST_POINTS = 200


@dataclass(frozen=True)
class TableSeen:
    """The table's plane in the base frame, as one view has it."""

    height_m: float
    """Above the configured table, amid what is seen of it."""
    tilt_rad: float
    """Against the base frame's horizontal."""
    share: float
    """Of the points near the configured height, those that lie on the plane."""


def share_in_view(
    T_base_camera: NDArray[np.float64], K: NDArray[np.float64], size: tuple[int, int], settings: CellSettings
) -> float:
    """How much of the workspace's floor lies within an image of `size` (width, height), measured or not; 0 to 1."""
    x_m, y_m, (floor_m, _) = settings.workspace_m
    x, y = np.meshgrid(np.linspace(*x_m, GRID), np.linspace(*y_m, GRID))
    points = transform_points(inverse(T_base_camera), np.column_stack([x.ravel(), y.ravel(), np.full(x.size, floor_m)]))
    pixels = points[points[:, 2] > 0] @ K.T
    pixels = pixels[:, :2] / pixels[:, 2:]
    inside = np.all((pixels >= 0) & (pixels <= np.array(size) - 1), axis=1)
    return float(inside.sum() / len(points))


def table_seen(view: View, settings: CellSettings) -> TableSeen | None:
    """The plane that most of what is seen in the workspace lies on; None if hardly anything is near the table."""
    points = _near_table(view, settings)
    if len(points) < LEAST_POINTS:
        return None
    # Strings and fixtures rise above the table and shadows lie below it; most of what is seen is the table itself.
    height = points[:, 2]
    count, edges = np.histogram(height, bins=max(int(np.ptp(height) / BIN_M), 1))
    most = int(count.argmax())
    centre = points[:, :2].mean(axis=0)
    A = np.column_stack([points[:, :2] - centre, np.ones(len(points))])
    plane = np.array([0.0, 0.0, (edges[most] + edges[most + 1]) / 2])
    on_plane = np.zeros(len(points), dtype=bool)
    for width in PASSES_M:
        on_plane = np.abs(height - A @ plane) < width
        if on_plane.sum() < LEAST_POINTS / 2:
            return None
        plane = np.linalg.lstsq(A[on_plane], height[on_plane], rcond=None)[0]
    return TableSeen(
        height_m=float(plane[2] - settings.mounting.table_z_m),
        tilt_rad=float(np.arctan(np.hypot(plane[0], plane[1]))),
        share=float(on_plane.mean()),
    )


def _near_table(view: View, settings: CellSettings) -> NDArray[np.float64]:
    """(N, 3) points in the workspace's rectangle and about as high as the table, base frame."""
    rows, columns = np.nonzero(view.depth[::STEP, ::STEP])
    points = deproject(view, STEP * rows, STEP * columns)
    (x0, x1), (y0, y1), (floor, _) = settings.workspace_m
    low, high = np.array([x0, y0, floor - NEAR_M]), np.array([x1, y1, floor + NEAR_M])
    return points[np.all((points >= low) & (points <= high), axis=1)]
