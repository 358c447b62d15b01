"""Measure how well the views saw each cell of the table: viewpoints, resolution, noise and free space.

A model states what is there, and also what is not: that there is no string, or that a string ends. Such a statement
holds only where the views would have shown the contrary.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from recognition.preprocessing.height_map import HeightLayer, merge_layers
from recognition.preprocessing.lines_of_sight import count_views
from recognition.preprocessing.normals import NormalCloud
from recognition.preprocessing.target_cloud import TargetCloud

CELL_M = 0.004
"""Edge length of a cell, metres: about the radius of a string."""
MIN_BASELINE_M = 0.01
"""Minimum distance of two cameras that are two viewpoints, metres. From nearer positions, views hide the same parts,
and their errors of the depth are similar."""
FREE_LEVELS_RADII = (1.0, 2.0, 3.0, 4.0, 6.0, 8.0)
"""Heights above the table at which free space is sought, in radii r: within a string, at its top, and above it."""


@dataclass(frozen=True, eq=False)
class SeenCells:
    """What the views saw in each of M by N square cells of the table: axis 0 is x, axis 1 is y.

    The table frame is the base frame if the table is where it is given (see `IngestedViews`).
    """

    x_m: float
    """Position of the first edge of the first cell along x, metres, table frame."""
    y_m: float
    """The same along y, metres, table frame."""
    cell_m: float
    """Edge length of the cells, metres."""
    viewpoints: NDArray[np.int64]
    """(M, N) number of viewpoints that measured the cell, or what lies on it up to the height of a string. Views from
    nearly the same position count once."""
    noise_m: NDArray[np.float64]
    """(M, N) standard deviation of the height of one pixel, metres, as the root mean square over the views that
    measured the cell; NaN where none did."""
    pixels_per_radius: NDArray[np.float64]
    """(M, N) number of pixels that the radius of a string covers in the nearest view that measured the cell; 0 where
    none did."""
    free_above_m: NDArray[np.float64]
    """(M, N) lowest height above the table from which on at least one view looks through each of `FREE_LEVELS_RADII`
    over the cell, metres; infinite where none looks through the highest one."""


def measure_seen_cells(
    views: Sequence[TargetCloud | NormalCloud], layers: Sequence[HeightLayer], table_z_m: float, r: float
) -> SeenCells:
    """Return what the views saw in each cell.

    Args:
        views: The V views, registered ones with their corrected poses.
        layers: Heights that the views measured. The grid of the cells covers all of them.
        table_z_m: Height of the table, metres, base frame.
        r: Radius of the strings, metres.
    """
    (x0, x1), (y0, y1) = merge_layers(layers, {layer.view: np.eye(4) for layer in layers}).extent_m
    x, y = np.meshgrid(np.arange(x0, x1, CELL_M) + CELL_M / 2, np.arange(y0, y1, CELL_M) + CELL_M / 2, indexing="ij")
    shape = x.shape
    table = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, table_z_m)])

    by_viewpoint = np.zeros((len(views), *shape), dtype=np.bool_)
    squares = np.zeros(shape)
    n_views = np.zeros(shape, dtype=np.int64)
    pixels_per_radius = np.zeros(shape)
    for view, viewpoint in zip(views, viewpoint_numbers(views), strict=True):
        counts = count_views(table, r, [view])
        is_measured = (counts.through + counts.stopped > 0).reshape(shape)
        by_viewpoint[viewpoint] |= is_measured
        n_views += is_measured
        squares += is_measured * view.scatter.pixel_m**2
        pixels = _pixels_per_metre(view, table).reshape(shape) * r
        pixels_per_radius = np.maximum(pixels_per_radius, np.where(is_measured, pixels, 0.0))
    with np.errstate(invalid="ignore"):
        noise_m = np.sqrt(squares / n_views)
    return SeenCells(
        x_m=x0,
        y_m=y0,
        cell_m=CELL_M,
        viewpoints=by_viewpoint.sum(axis=0),
        noise_m=noise_m,
        pixels_per_radius=pixels_per_radius,
        free_above_m=_free_above(views, table, r).reshape(shape),
    )


def viewpoint_numbers(views: Sequence[TargetCloud | NormalCloud]) -> list[int]:
    """Return the number of the viewpoint of each view. Views from nearly the same position have the same number."""
    centres: list[NDArray[np.float64]] = []
    numbers: list[int] = []
    for view in views:
        assert view.T_base_camera is not None
        position = view.T_base_camera[:3, 3]
        near = [k for k, centre in enumerate(centres) if np.linalg.norm(position - centre) < MIN_BASELINE_M]
        if not near:
            near = [len(centres)]
            centres.append(position)
        numbers.append(near[0])
    return numbers


def is_single_viewpoint(views: Sequence[TargetCloud | NormalCloud]) -> bool:
    """Return whether there are views, and all of them are from nearly the same position."""
    return set(viewpoint_numbers(views)) == {0}


def _pixels_per_metre(view: TargetCloud | NormalCloud, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the pixels (N,) that a metre across the line of sight covers at points (N, 3); 0 behind the camera."""
    assert view.image is not None
    assert view.T_base_camera is not None
    depth_m = (points - view.T_base_camera[:3, 3]) @ view.T_base_camera[:3, 2]
    return np.where(depth_m > 0, view.image.K[0, 0] / np.maximum(depth_m, 1e-6), 0.0)


def _free_above(
    views: Sequence[TargetCloud | NormalCloud], table: NDArray[np.float64], r: float
) -> NDArray[np.float64]:
    """Return the height (N,) above points of the table from which on views look through all higher levels, metres."""
    free_above_m = np.full(len(table), np.inf)
    is_free = np.ones(len(table), dtype=np.bool_)
    for level in reversed(FREE_LEVELS_RADII):
        is_free &= count_views(table + (0.0, 0.0, level * r), r, views).through > 0
        free_above_m[is_free] = level * r
    return free_above_m
