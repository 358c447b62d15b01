"""Local floor: the height of what lies under and beside the strings, for the fingertips of a gripper.

The table is the floor where nothing else lies. A plate, a bar or a fixture that rises above the noise of the table is
the floor there, even if it is lower than the height threshold z_t.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from recognition.geometry.polyline import close_polyline, points_at, resampled_lengths
from recognition.model.chains import Chain
from recognition.model.findings import Finding, finding
from recognition.preprocessing.height_map import NO_HEIGHTS, HeightMap
from recognition.preprocessing.support_surface import EDGE_M, MIN_RAISED_M, SupportSurface

MIN_HEIGHT_M = MIN_RAISED_M
"""Minimum height of an object above the table around it, metres, at low noise."""
MIN_HEIGHT_SIGMAS = 5.0
"""Minimum height of an object above the table around it, in standard deviations of the table cells of the scan."""
EDGE_SHARE = 0.6
"""Minimum height of a cell beside those of an object that belongs to it, as a share of the minimum height."""
MIN_CELLS = 3
"""Minimum number of connected cells of an object. Fewer cells are noise, or stray pixels of the edge of a string."""
MIN_STEP_M = 0.0006
"""Minimum height of a cell above its lowest neighbour at the edge of an object, metres."""
SIGMA_PER_MAD = 1.4826
"""Standard deviation of normally distributed heights, in medians of their absolute values."""
NEIGHBOURS = np.ones((3, 3))
"""A cell and the eight cells around it."""
BACKGROUND_M = 0.06
"""Width of the window in which the table around a cell is averaged, metres. The average removes slow errors of the
camera, which are the same for a string and the table beside it."""


@dataclass(frozen=True, eq=False)
class LocalFloor:
    """Height of the floor in each cell of the table, and which cells are objects on the table."""

    x_m: float
    """Position of the first edge of the first cell along x, metres, base frame."""
    y_m: float
    """The same along y, metres, base frame."""
    cell_m: float
    """Edge length of the cells, metres."""
    z_m: NDArray[np.float64]
    """(M, N) height of the floor, metres, base frame. -inf within `EDGE_M` of a string, where the floor is not
    seen, and inf where no view measured anything."""
    is_raised: NDArray[np.bool_]
    """(M, N) mask of the cells of objects that rise above the table."""
    min_height_m: float
    """Minimum height of an object above the noise of the table, metres."""
    table_z_m: float
    """Height of the table plane, metres, base frame."""

    def highest(self, xy: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the highest floor under a set of positions.

        Args:
            xy: (N, K, 2) positions, metres, base frame.

        Returns:
            (N,) heights, metres, base frame: at least `table_z_m`, and inf if a position was not measured.
        """
        rows, columns = self.z_m.shape
        if self.z_m.size == 0:
            return np.full(len(xy), np.inf)
        i = np.floor((xy[..., 0] - self.x_m) / self.cell_m).astype(np.int64)
        j = np.floor((xy[..., 1] - self.y_m) / self.cell_m).astype(np.int64)
        inside = (i >= 0) & (i < rows) & (j >= 0) & (j < columns)
        z = np.full(xy.shape[:-1], np.inf)
        z[inside] = self.z_m[i[inside], j[inside]]
        return np.asarray(np.maximum(z, self.table_z_m).max(axis=-1), dtype=np.float64)

    def edge_points(self) -> NDArray[np.float64]:
        """Return the top centres (K, 3) of the raised cells beside a lower one, metres, base frame.

        What is outside an object is nearest to one of these cells.
        """
        if self.z_m.size == 0:
            return np.empty((0, 3))
        z = np.where(np.isfinite(self.z_m), self.z_m, self.table_z_m)
        lowest = np.asarray(ndimage.minimum_filter(z, 3), dtype=np.float64)
        i, j = np.nonzero(self.is_raised & (z - lowest > MIN_STEP_M))
        cells = np.array([i, j, z[i, j]], dtype=np.float64).T
        return cells * (self.cell_m, self.cell_m, 1.0) + (self.x_m + self.cell_m / 2, self.y_m + self.cell_m / 2, 0.0)


def find_local_floor(support: SupportSurface, chains: Sequence[Chain]) -> LocalFloor:
    """Return the floor for the fingertips: the table, and every object that rises above its noise.

    Args:
        support: Table plane and height map.
        chains: Chains of the model. Their strings are not part of the floor.

    Returns:
        The floor, in the cells of the height map. It has no cells without a height map.
    """
    height_map = support.heights or NO_HEIGHTS
    table_z_m = support.table_z_m
    z = height_map.z_m.astype(np.float64) - table_z_m
    near_string = _near_strings(height_map, chains)
    measured = np.isfinite(z) & ~near_string
    background = _background(z, measured & (np.abs(z) < MIN_HEIGHT_M), height_map.cell_m)
    residual = z - background
    noise = residual[measured & (np.abs(residual) < MIN_HEIGHT_M)]
    sigma = 0.0
    if len(noise):
        sigma = float(SIGMA_PER_MAD * np.median(np.abs(noise)))
    min_height = max(MIN_HEIGHT_M, MIN_HEIGHT_SIGMAS * sigma)
    is_raised = _raised_cells(np.where(measured, residual, -np.inf), min_height)

    floor = np.where(is_raised, z, np.maximum(background, 0.0))
    # A pixel may be missing in every view. The cells around it show what lies there.
    is_missing = ~np.isfinite(z)
    objects = np.where(is_missing, -np.inf, np.where(is_raised, z, 0.0))
    around = ndimage.maximum_filter(objects, 3)
    floor[is_missing] = np.where(np.isfinite(around), around, np.inf)[is_missing]
    floor[near_string] = -np.inf
    return LocalFloor(
        x_m=height_map.x_m,
        y_m=height_map.y_m,
        cell_m=height_map.cell_m,
        z_m=floor + table_z_m,
        is_raised=is_raised,
        min_height_m=min_height,
        table_z_m=table_z_m,
    )


def low_object_findings(floor: LocalFloor) -> list[Finding]:
    """Return the finding on low objects that the noise of the table hides, or none at low noise.

    Heights are compared in tenths of a millimetre.
    """
    if round(floor.min_height_m, 4) <= MIN_HEIGHT_M:
        return []
    message = (
        f"objects lower than {floor.min_height_m * 1000:.1f} mm are hidden in the noise of the measured table, "
        "and a fingertip may come down on one"
    )
    return [finding("low-objects-hidden", message, value=floor.min_height_m, limit=MIN_HEIGHT_M)]


def _raised_cells(height: NDArray[np.float64], min_height: float) -> NDArray[np.bool_]:
    """Return the mask (M, N) of the cells of objects.

    Args:
        height: (M, N) height above the table around each cell, metres; -inf where it was not measured.
        min_height: Minimum height of an object, metres.
    """
    is_raised = height > min_height
    label = np.zeros(is_raised.shape, dtype=np.int32)
    ndimage.label(is_raised, structure=NEIGHBOURS, output=label)
    size = np.bincount(label.ravel(), minlength=1)
    is_raised &= (size >= MIN_CELLS)[label]
    # Cells beside them that are partly on the object, or on it and low by noise.
    is_beside = np.asarray(ndimage.binary_dilation(is_raised, NEIGHBOURS), dtype=np.bool_)
    return is_raised | (is_beside & (height > EDGE_SHARE * min_height))


def _near_strings(height_map: HeightMap, chains: Sequence[Chain]) -> NDArray[np.bool_]:
    """Return the mask (M, N) of the cells within `EDGE_M` of the surface of a string, seen from above."""
    near = np.zeros(height_map.z_m.shape, dtype=bool)
    cell_m = height_map.cell_m
    origin = np.array([height_map.x_m, height_map.y_m])
    for chain in chains:
        line = close_polyline(chain.points, chain.closed)
        points = points_at(line, resampled_lengths(line, cell_m / 2))[:, :2] - origin
        reach = chain.radius_m + EDGE_M
        steps = np.arange(-np.ceil(reach / cell_m), np.ceil(reach / cell_m) + 1)
        cells = (np.floor(points / cell_m)[:, None] + steps[:, None]).astype(np.int64)  # (N, steps, 2)
        squares = ((cells + 0.5) * cell_m - points[:, None]) ** 2
        is_near = squares[:, :, None, 0] + squares[:, None, :, 1] <= reach**2
        inside = (cells >= 0) & (cells < near.shape)
        point, i, j = np.nonzero(is_near & inside[:, :, None, 0] & inside[:, None, :, 1])
        near[cells[point, i, 0], cells[point, j, 1]] = True
    return near


def _background(z: NDArray[np.float64], is_table: NDArray[np.bool_], cell_m: float) -> NDArray[np.float64]:
    """Return the mean height (M, N) of the table cells in the window around each cell; 0 without a table cell."""
    size = 2 * round(BACKGROUND_M / cell_m / 2) + 1
    weight = ndimage.uniform_filter(is_table.astype(np.float64), size, mode="constant")
    total = ndimage.uniform_filter(np.where(is_table, z, 0.0), size, mode="constant")
    return np.where(weight > 0.5 / size**2, total / np.maximum(weight, 1 / size**2), 0.0)
