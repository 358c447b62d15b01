"""Height map of the workspace: what every view measured in each square cell of the table, the table included.

The height threshold removes the table from the target clouds, and with it everything that lies low. The height map
keeps it. Each view is aligned to the table plane by itself, and the median over the views rejects the errors of one.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from recognition.preprocessing.target_cloud import FLOOR_MARGIN_M, DepthView, Scene, TargetCloud

CELL_M = 0.002
"""Edge length of a cell, metres. At 0.4 m, a camera with 640 columns measures about five pixels in a cell."""
BESIDE_M = 0.008
"""Width of the ring in which the floor beside a string is measured, metres."""
MARGIN_M = 0.03
"""Width of the map around the workspace, metres: a finger at a string near the border may come down there."""
MAX_PIXELS = 450_000
"""Maximum number of pixels of one view, evenly subsampled. Neighbouring pixels have almost the same error."""
MAX_EXTENT_M = 1.5
"""Maximum extent of the layer of one view along x and along y, metres, about the point of the table that the camera
looks at."""
MAX_MAP_M = 3.0
"""Maximum extent of the height map along x and along y, metres, about the median of its layers. Views that look
elsewhere are cut off, since the map of two distant places would fill the memory."""
MIN_DOWNWARD_COSINE = 0.1
"""Minimum cosine of the angle between the optical axis and the vertical for which the camera looks at the table."""


@dataclass(frozen=True, eq=False)
class HeightLayer:
    """Mean heights that one view measured in the cells of a grid. The grids of all views coincide."""

    view: int
    """Index of the view."""
    first: tuple[int, int]
    """Indices (i, j) of the first cell. Cell (i, j) begins at x = i * `CELL_M`, y = j * `CELL_M`."""
    z_m: NDArray[np.float32]
    """(M, N) mean height of the points in each cell, metres, base frame; NaN in a cell without a point."""


@dataclass(frozen=True, eq=False)
class HeightMap:
    """Height of the measured surface in each cell of the table, as seen from above."""

    x_m: float
    """Position of the first edge of the first cell along x, metres, base frame."""
    y_m: float
    """The same along y, metres, base frame."""
    cell_m: float
    """Edge length of the cells, metres."""
    z_m: NDArray[np.float32]
    """(M, N) median of the views in M by N cells along x and y, metres, base frame; NaN where no view measured."""

    @property
    def extent_m(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """((x0, x1), (y0, y1)) of the map, metres, base frame."""
        rows, columns = self.z_m.shape
        x_end = self.x_m + rows * self.cell_m
        y_end = self.y_m + columns * self.cell_m
        return (self.x_m, x_end), (self.y_m, y_end)

    def cell_centres(self) -> NDArray[np.float64]:
        """Return the centres (M, N, 2) of the cells, metres, base frame."""
        rows, columns = (np.arange(n) + 0.5 for n in self.z_m.shape)
        x, y = np.meshgrid(self.x_m + rows * self.cell_m, self.y_m + columns * self.cell_m, indexing="ij")
        return np.stack([x, y], axis=-1)

    def peaks(self, min_z_m: float, block_m: float) -> NDArray[np.float64]:
        """Return the highest point of each square block of cells that rises above a height.

        Args:
            min_z_m: Height, metres, base frame.
            block_m: Edge length of the blocks, metres.

        Returns:
            (K, 3) points at the middle of cells, metres, base frame.
        """
        i, j = np.nonzero(np.nan_to_num(self.z_m, nan=-np.inf) > min_z_m)
        z = self.z_m[i, j].astype(np.float64)
        order = np.argsort(-z, kind="stable")
        cells = np.column_stack([i, j])[order]
        z = z[order]
        # The first cell of each block is its highest one.
        per_block = max(1, round(block_m / self.cell_m))
        _, first = np.unique(cells // per_block, axis=0, return_index=True)
        xy = (cells[first] + 0.5) * self.cell_m + (self.x_m, self.y_m)
        return np.column_stack([xy, z[first]]).astype(np.float64)

    def floor_beside(self, points: NDArray[np.float64], inner_m: float) -> NDArray[np.float64]:
        """Return the height of what lies on both sides of positions on a string.

        It is the lower quartile of the cells between `inner_m` and `inner_m` + `BESIDE_M`, seen from above, so that
        another string or an object at one side does not count.

        Args:
            points: (N, 2) positions, metres, base frame.
            inner_m: Distance from the positions within which the string itself was measured, metres.

        Returns:
            (N,) heights, metres, base frame; NaN where no view measured a cell.
        """
        outer = inner_m + BESIDE_M
        steps = np.arange(-np.ceil(outer / self.cell_m), np.ceil(outer / self.cell_m) + 1)
        offsets = np.stack(np.meshgrid(steps, steps, indexing="ij"), axis=-1).reshape(-1, 2)
        # A cell is within one diagonal of the position that its offset is measured from.
        length = np.linalg.norm(offsets, axis=1) * self.cell_m
        diagonal = np.sqrt(2) * self.cell_m
        offsets = offsets[(length > inner_m - diagonal) & (length < outer + diagonal)]
        from_corner = (points - (self.x_m, self.y_m)) / self.cell_m
        cells = (np.floor(from_corner)[:, None] + offsets).astype(np.int64)
        distance = np.linalg.norm(cells + 0.5 - from_corner[:, None], axis=-1) * self.cell_m
        inside = np.asarray(((cells >= 0) & (cells < self.z_m.shape)).all(axis=-1))
        z = np.full(cells.shape[:2], np.nan)
        z[inside] = self.z_m[cells[inside][:, 0], cells[inside][:, 1]]
        z[(distance < inner_m) | (distance > outer)] = np.nan
        z.sort(axis=1)  # NaN last
        count = np.isfinite(z).sum(axis=1)
        return np.take_along_axis(z, count[:, None] // 4, axis=1)[:, 0]


NO_HEIGHTS = HeightMap(0.0, 0.0, CELL_M, np.empty((0, 0), dtype=np.float32))
"""A map without cells."""


def height_layer(view: DepthView, target: TargetCloud, scene: Scene) -> HeightLayer:
    """Return the mean heights that one view measured in each cell, after its alignment to the table plane.

    Args:
        view: Depth image.
        target: Target cloud of the view; uses its aligned camera pose.
        scene: Workspace.

    Returns:
        The layer.
    """
    low, high = _grid_extent(target.T_base_camera, scene)
    first = np.floor(low / CELL_M).astype(np.int64)
    rows, columns = (int(n) for n in np.ceil(high / CELL_M).astype(np.int64) - first)
    i, j, z, kept = _points_in_grid(view, target.T_base_camera, first)
    kept &= (i >= 0) & (i < rows) & (j >= 0) & (j < columns)
    if scene.workspace_m is not None:
        kept &= (z >= scene.workspace_m[2][0] - FLOOR_MARGIN_M) & (z <= scene.workspace_m[2][1])
    # Points that do not count go into one more cell at the end.
    n_cells = rows * columns
    i, j = (np.where(kept, axis, 0).astype(np.int32) for axis in (i, j))
    cell = np.where(kept, i * np.int32(columns) + j, np.int32(n_cells))
    count = np.bincount(cell, minlength=n_cells + 1)
    total = np.bincount(cell, z, minlength=n_cells + 1)
    with np.errstate(invalid="ignore"):
        mean = (total[:-1] / count[:-1]).astype(np.float32).reshape(rows, columns)
    return HeightLayer(target.view, (int(first[0]), int(first[1])), mean)


def merge_layers(layers: Sequence[HeightLayer], T_registration: Mapping[int, NDArray[np.float64]]) -> HeightMap:
    """Return the median over the views in each cell.

    Args:
        layers: Layers of the views.
        T_registration: Motion (4, 4) of each used view by the registration, base to base, metres, by the index of the
            view. Its part in the table plane moves the layer; the heights stay aligned to the table plane. Layers of
            other views are ignored.

    Returns:
        The height map. It has no cells if no used view measured anything.
    """
    layers = [layer for layer in layers if layer.view in T_registration and layer.z_m.size]
    if not layers:
        return NO_HEIGHTS
    begin, end = _map_extent(layers)
    x, y = ((np.arange(first, last) + 0.5) * CELL_M for first, last in zip(begin, end, strict=True))
    stack = np.empty((len(layers), len(x), len(y)), dtype=np.float32)
    for number, layer in enumerate(layers):
        stack[number] = _moved_heights(layer, T_registration[layer.view], x, y)
    return HeightMap(float(begin[0]) * CELL_M, float(begin[1]) * CELL_M, CELL_M, _median(stack))


def _map_extent(layers: Sequence[HeightLayer]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the first cell (2,) of the map of all layers, and the cell (2,) after the last one."""
    begin = np.min([layer.first for layer in layers], axis=0)
    end = np.max([np.add(layer.first, layer.z_m.shape) for layer in layers], axis=0)
    middle = np.median([np.add(layer.first, np.array(layer.z_m.shape) // 2) for layer in layers], axis=0)
    max_size = round(MAX_MAP_M / CELL_M)
    limited_begin = np.maximum(begin, middle.astype(np.int64) - max_size // 2)
    begin = np.where(end - begin > max_size, limited_begin, begin)
    return begin, np.minimum(end, begin + max_size)


def _moved_heights(
    layer: HeightLayer, T_registration: NDArray[np.float64], x: NDArray[np.float64], y: NDArray[np.float64]
) -> NDArray[np.float32]:
    """Return the heights (M, N) of a moved layer at the positions x (M,) and y (N,), metres; NaN outside the layer."""
    T = np.linalg.inv(T_registration)
    # The cells around the layer have no height.
    heights = np.pad(layer.z_m, 1, constant_values=np.nan)
    cells = []
    for k in range(2):
        # Each coordinate in the layer is a term in x plus a term in y.
        along_x = (T[k, 0] * x + T[k, 3]) / CELL_M
        along_y = T[k, 1] * y / CELL_M
        cell = np.floor(np.add.outer(along_x, along_y)).astype(np.int32) - (layer.first[k] - 1)
        cells.append(np.clip(cell, 0, heights.shape[k] - 1))
    i, j = cells
    return heights.take(i * np.int32(heights.shape[1]) + j)


def _grid_extent(T_base_camera: NDArray[np.float64], scene: Scene) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the corners (2,) of the grid: the workspace and its margin, or a square where the camera looks, metres."""
    eye = T_base_camera[:3, 3]
    axis = T_base_camera[:3, 2]
    distance = 0.0
    if axis[2] < -MIN_DOWNWARD_COSINE:
        distance = (scene.table_z_m - eye[2]) / axis[2]
    centre = eye[:2] + distance * axis[:2]
    if scene.workspace_m is None:
        return centre - MAX_EXTENT_M / 2, centre + MAX_EXTENT_M / 2
    low, high = np.asarray(scene.workspace_m, dtype=np.float64)[:2].T
    low = low - MARGIN_M
    high = high + MARGIN_M
    # A large workspace is covered where the camera looks.
    begin = np.clip(centre - MAX_EXTENT_M / 2, low, np.maximum(high - MAX_EXTENT_M, low))
    return begin, np.minimum(high, begin + MAX_EXTENT_M)


def _points_in_grid(
    view: DepthView, T_base_camera: NDArray[np.float64], first: NDArray[np.int64]
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32], NDArray[np.bool_]]:
    """Return the pixels (N,) of a view: x and y in cells from the cell `first`, z in metres, and whether measured.

    Single precision rounds by a micrometre at most.
    """
    step = int(np.ceil(np.sqrt(max(view.depth.size / MAX_PIXELS, 1.0))))
    counts = view.depth[step // 2 :: step, step // 2 :: step]
    rows, columns = (np.arange(n)[step // 2 :: step] for n in view.depth.shape)
    depth = counts.astype(np.float32)
    scale = np.array([1 / CELL_M, 1 / CELL_M, 1.0])
    M = T_base_camera[:3, :3] @ np.linalg.inv(view.K) * view.depth_unit_m * scale[:, None]
    t = T_base_camera[:3, 3] * scale - (first[0], first[1], 0.0)
    axes = []
    for k in range(3):
        axis = np.add.outer((M[k, 1] * rows + M[k, 2]).astype(np.float32), (M[k, 0] * columns).astype(np.float32))
        axis *= depth
        axis += np.float32(t[k])
        axes.append(axis.ravel())
    x, y, z = axes
    return x, y, z, counts.ravel() > 0


def _median(stack: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the median (M, N) of the finite values of each cell of `stack` (V, M, N); NaN without one."""
    ordered = np.sort(stack, axis=0)  # NaN last
    last = np.maximum(np.isfinite(stack).sum(axis=0) - 1, 0)
    low, high = (np.take_along_axis(ordered, index[None], axis=0)[0] for index in (last // 2, (last + 1) // 2))
    return (low + high) * np.float32(0.5)
