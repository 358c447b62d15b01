"""Coverage of the table by the views. Strings may be missed where too few views show the table.

A scan of several views should show each part of the table twice, so that the views check each other. A scan of a single
view can show it only once.
"""

from collections.abc import Collection, Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from recognition.model.findings import Finding, finding
from recognition.preprocessing.target_cloud import Scene, TargetCloud
from recognition.preprocessing.view_selection import MIN_POINTS

Interval = tuple[float, float]

MIN_VIEWS = 2
"""Minimum number of views that show a covered part of the table. For a scan of a single view, it is 1."""
MAX_SQUARE_M = 0.01
"""Maximum side of the squares of the table for which coverage is computed, metres. `MAX_SQUARES` has priority."""
MAX_SQUARES = 120
"""Maximum number of squares along x and along y. In a large workspace, the squares are larger than `MAX_SQUARE_M`."""
MIN_REPORTED_SHARE = 0.02
"""Minimum uncovered share of the table that is reported. A smaller share is a sliver at the border, within the accuracy
of the poses and the size of the squares."""
RECTANGLE_STEPS = 20
"""Number of steps along x and along y in the search for the largest covered rectangle."""
ROUNDING_SQUARES = 1e-9
"""Excess over a whole number of squares that is due to rounding and adds no square."""
CM2_PER_M2 = 1e4
"""Square centimetres per square metre."""


@dataclass(frozen=True, eq=False)
class CameraFrustum:
    """Viewing volume of one view, given by the camera model and the camera pose."""

    K: NDArray[np.float64]
    """(3, 3) pinhole matrix, pixels."""
    width: int
    """Width of the image, pixels."""
    height: int
    """Height of the image, pixels."""
    T_base_camera: NDArray[np.float64]
    """(4, 4) camera pose in the base frame, metres."""


@dataclass(frozen=True, eq=False)
class Coverage:
    """Number of views that show each square of the table in the workspace."""

    x_m: Interval
    """Extent of the workspace along x in the base frame, metres."""
    y_m: Interval
    """Extent of the workspace along y in the base frame, metres."""
    view_count: NDArray[np.int64]
    """(M, N) number of views for each of M by N squares along x and y."""
    min_views: int = MIN_VIEWS
    """Minimum number of views that show a covered square."""

    @property
    def is_covered(self) -> NDArray[np.bool_]:
        """(M, N) mask, True for squares that at least `min_views` views show."""
        return self.view_count >= self.min_views

    @property
    def covered_share(self) -> float:
        """Share of the table in the workspace that is covered, 0 to 1."""
        return float(self.is_covered.mean())


@dataclass(frozen=True)
class _Rectangle:
    """Rectangle of squares of the table."""

    rows: tuple[int, int]
    """Start and stop index along x."""
    columns: tuple[int, int]
    """Start and stop index along y."""

    @property
    def n_squares(self) -> int:
        """Number of squares."""
        return int(np.ptp(self.rows) * np.ptp(self.columns))


def table_coverage(
    frustums: Iterable[CameraFrustum], x_m: Interval, y_m: Interval, table_z_m: float, n_views: int = MIN_VIEWS
) -> Coverage:
    """Return the number of views that show each square of the table.

    A view shows a square if the centre of the square is in front of the camera and projects into the image. Occlusion
    and the depth range of the camera are not checked.

    Args:
        frustums: Camera model and pose of each view.
        x_m: Extent of the workspace along x in the base frame, metres.
        y_m: Extent of the workspace along y in the base frame, metres.
        table_z_m: Height of the table plane in the base frame, metres.
        n_views: Number of views of the scan, with those that cannot be used.

    Returns:
        The coverage of the table in the workspace.
    """
    x = _square_centres(x_m)
    y = _square_centres(y_m)
    view_count = np.zeros((len(x), len(y)), dtype=np.int64)
    for frustum in frustums:
        view_count += _is_shown(frustum, x, y, table_z_m)
    return Coverage(x_m, y_m, view_count, min(n_views, MIN_VIEWS))


def coverage_message(coverage: Coverage) -> str | None:
    """Return a message about the part of the table that fewer than `coverage.min_views` views show.

    Args:
        coverage: Coverage of the table in the workspace.

    Returns:
        The message, or None if at most `MIN_REPORTED_SHARE` of the table is not covered.
    """
    share = float((~coverage.is_covered).mean())
    if share <= MIN_REPORTED_SHARE:
        return None
    area_cm2 = CM2_PER_M2 * share * _length(coverage.x_m) * _length(coverage.y_m)
    seen_in = "no view" if coverage.min_views == 1 else f"fewer than {coverage.min_views} views"
    return (
        f"{100 * share:.0f} % of the table in the workspace ({area_cm2:.0f} cm2) is in {seen_in}, "
        f"and strings there may be missed or cut short; {_describe_extent(coverage)}"
    )


def coverage_findings(targets: Iterable[TargetCloud], used: Collection[int], scene: Scene) -> list[Finding]:
    """Return the finding on the part of the table that too few views of a scan show.

    Views that measured the table but no string are counted too, because they would have shown a string.

    Args:
        targets: Target clouds of all views.
        used: Indices of the views in the model.
        scene: Table height and workspace.

    Returns:
        One finding, or none if the table is covered or the scene has no workspace.
    """
    if scene.workspace_m is None:
        return []
    targets = list(targets)
    frustums = []
    for target in targets:
        saw_only_table = target.n_in_workspace >= MIN_POINTS > len(target.points)
        if target.image is not None and (target.view in used or saw_only_table):
            height, width = target.image.depth.shape
            frustums.append(CameraFrustum(target.image.K, width, height, target.T_base_camera))
    x_m, y_m, _ = scene.workspace_m
    coverage = table_coverage(frustums, x_m, y_m, scene.table_z_m, len(targets))
    message = coverage_message(coverage)
    if message is None:
        return []
    return [finding("table-not-covered", message, value=1 - coverage.covered_share, limit=MIN_REPORTED_SHARE)]


def _is_shown(
    frustum: CameraFrustum, x: NDArray[np.float64], y: NDArray[np.float64], table_z_m: float
) -> NDArray[np.bool_]:
    """Return the mask (M, N) of the points of the table at x (M,) and y (N,) that project into the image."""
    R = frustum.T_base_camera[:3, :3]
    t = frustum.T_base_camera[:3, 3]
    # A homography maps the table plane to the image. Each homogeneous coordinate is a term in x plus a term in y.
    H = frustum.K @ R.T @ np.column_stack([np.eye(3, 2), np.array([0.0, 0.0, table_z_m]) - t])
    H_x, H_y, H_1 = H.T
    u, v, w = (np.add.outer(H_x[k] * x + H_1[k], H_y[k] * y) for k in range(3))
    is_in_columns = (u >= 0) & (u <= (frustum.width - 1) * w)
    is_in_rows = (v >= 0) & (v <= (frustum.height - 1) * w)
    return (w > 0) & is_in_columns & is_in_rows


def _length(extent_m: Interval) -> float:
    low, high = extent_m
    return high - low


def _square_centres(extent_m: Interval) -> NDArray[np.float64]:
    edges = np.linspace(*extent_m, _square_count(extent_m) + 1)
    return (edges[:-1] + edges[1:]) / 2


def _square_count(extent_m: Interval) -> int:
    return int(np.clip(np.ceil(_length(extent_m) / MAX_SQUARE_M - ROUNDING_SQUARES), 1, MAX_SQUARES))


def _describe_extent(coverage: Coverage) -> str:
    """Describe the bounding box of the uncovered part if the box is small, else the largest covered rectangle."""
    is_covered = coverage.is_covered
    if not is_covered.any():
        return "this part is the whole table in the workspace"
    rows, columns = np.nonzero(~is_covered)
    box = _Rectangle(rows=(int(rows.min()), int(rows.max()) + 1), columns=(int(columns.min()), int(columns.max()) + 1))
    if box.n_squares <= is_covered.size / 2:
        return f"this part lies within {_format_rectangle(coverage, box)}"
    largest = _largest_covered_rectangle(is_covered)
    if largest is None:
        return "this part is scattered over the table"
    return f"the largest covered rectangle is {_format_rectangle(coverage, largest)}"


def _largest_covered_rectangle(is_covered: NDArray[np.bool_]) -> _Rectangle | None:
    """Return the largest covered rectangle, in coarse steps, or None."""
    # Summed-area table: the sum over a rectangle needs four entries of the table.
    sums = np.zeros((is_covered.shape[0] + 1, is_covered.shape[1] + 1), dtype=np.int64)
    sums[1:, 1:] = is_covered.cumsum(axis=0).cumsum(axis=1)
    n_rows, n_columns = is_covered.shape
    x0, x1 = _intervals(n_rows)
    y0, y1 = _intervals(n_columns)
    covered = sums[np.ix_(x1, y1)] - sums[np.ix_(x0, y1)] - sums[np.ix_(x1, y0)] + sums[np.ix_(x0, y0)]
    area = np.outer(x1 - x0, y1 - y0)
    i, j = np.unravel_index((area * (covered == area)).argmax(), area.shape)
    if covered[i, j] < area[i, j]:
        return None
    return _Rectangle(rows=(int(x0[i]), int(x1[i])), columns=(int(y0[j]), int(y1[j])))


def _intervals(size: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the start and stop indices of all coarse intervals on an axis of `size` squares."""
    steps = np.unique(np.linspace(0, size, RECTANGLE_STEPS + 1).astype(np.int64))
    first, last = np.triu_indices(len(steps), 1)
    return steps[first], steps[last]


def _format_rectangle(coverage: Coverage, rectangle: _Rectangle) -> str:
    n_rows, n_columns = coverage.view_count.shape
    x = _format_interval(coverage.x_m, n_rows, rectangle.rows)
    y = _format_interval(coverage.y_m, n_columns, rectangle.columns)
    return f"x {x}, y {y}"


def _format_interval(extent_m: Interval, count: int, indices: tuple[int, int]) -> str:
    """Return the metres from the start to the stop index of an interval of the `count` squares along an extent."""
    low, high = extent_m
    start, stop = (low + index / count * (high - low) for index in indices)
    return f"{start:.2f} to {stop:.2f} m"
