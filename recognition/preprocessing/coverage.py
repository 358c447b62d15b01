"""Which part of the table the pictures show: a string that lies elsewhere is missed, and nothing else tells so."""

from collections.abc import Collection, Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from recognition.preprocessing.target_cloud import Scene, TargetCloud
from recognition.preprocessing.view_selection import MIN_POINTS, MIN_VIEWS

Range = tuple[float, float]

STEP_M = 0.01
"""The table is looked at in squares of at most this side ..."""
MOST_SQUARES = 120
"""... but of a large workspace in this many each way: more than a centimetre is exact enough there."""
NOTABLE_SHARE = 0.02
"""Of the workspace. Less is a sliver along its edge: poses are not that exact, nor are squares of a centimetre."""
BLOCKS = 20
"""A rectangle that is in view throughout is looked for in so many steps each way."""


@dataclass(frozen=True, eq=False)
class ImagedArea:
    """One picture of the table."""

    K: NDArray[np.float64]
    """(3, 3) pinhole matrix, pixels."""
    width: int
    height: int
    T_base_camera: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Coverage:
    """How many pictures show each square of the table in the workspace."""

    x_m: Range
    y_m: Range
    """The workspace, base frame."""
    pictures: NDArray[np.int64]
    """(M, N): its M by N squares along x and y."""

    @property
    def in_view(self) -> NDArray[np.bool_]:
        """(M, N): which squares are in as many pictures as a string needs."""
        return self.pictures >= MIN_VIEWS

    @property
    def share(self) -> float:
        """How much of the table is in as many pictures, 0 to 1."""
        return float(self.in_view.mean())


def table_coverage(looks: Iterable[ImagedArea], x_m: Range, y_m: Range, table_z_m: float) -> Coverage:
    """How many of `looks` have each square of the table z = `table_z_m` within `x_m` and `y_m` in the picture.

    That is where the square's middle lies in front of the camera and within the image. What hides it there, and
    whether the camera measures at that distance, is not asked.
    """
    x, y = _middles(x_m), _middles(y_m)
    pictures = np.zeros((len(x), len(y)), dtype=np.int64)
    for look in looks:
        # A picture of a plane is a projective map, and each of its three parts is one of x plus one of y.
        R, t = look.T_base_camera[:3, :3], look.T_base_camera[:3, 3]
        of_x, of_y, rest = (look.K @ R.T @ np.column_stack([np.eye(3, 2), np.array([0.0, 0.0, table_z_m]) - t])).T
        u, v, w = (np.add.outer(of_x[k] * x + rest[k], of_y[k] * y) for k in range(3))
        pictures += (w > 0) & (u >= 0) & (u <= (look.width - 1) * w) & (v >= 0) & (v <= (look.height - 1) * w)
    return Coverage(x_m, y_m, pictures)


def coverage_message(coverage: Coverage) -> str | None:
    """In words, how much of the table is in too few pictures, and where; None where that is next to nothing."""
    missing = float((~coverage.in_view).mean())
    if missing <= NOTABLE_SHARE:
        return None
    area = 1e4 * missing * (coverage.x_m[1] - coverage.x_m[0]) * (coverage.y_m[1] - coverage.y_m[0])
    return (
        f"{100 * missing:.0f} % of the table in the workspace ({area:.0f} cm2) is in fewer than {MIN_VIEWS} pictures, "
        f"and strings there may be missed or cut short; {_where(coverage)}"
    )


def coverage_warnings(targets: Iterable[TargetCloud], used: Collection[int], scene: Scene) -> list[str]:
    """The warning of a scan, if any: of its `targets`, the views with the indices in `used` made the model.

    A view that looked at the table and had no string in its picture counts as well: it would have shown one.
    """
    if scene.workspace_m is None:
        return []
    looks = []
    for target in targets:
        saw_no_string = target.in_workspace >= MIN_POINTS > len(target.points)
        if target.image is not None and (target.view in used or saw_no_string):
            height, width = target.image.depth.shape
            looks.append(ImagedArea(target.image.K, width, height, target.T_base_camera))
    x_m, y_m, _ = scene.workspace_m
    said = coverage_message(table_coverage(looks, x_m, y_m, scene.table_z_m))
    return [] if said is None else [said]


def _middles(side_m: Range) -> NDArray[np.float64]:
    edges = np.linspace(*side_m, _squares(side_m) + 1)
    return (edges[:-1] + edges[1:]) / 2


def _squares(side_m: Range) -> int:
    return int(np.clip(np.ceil((side_m[1] - side_m[0]) / STEP_M - 1e-9), 1, MOST_SQUARES))


def _where(coverage: Coverage) -> str:
    in_view = coverage.in_view
    if not in_view.any():
        return "that is all of it"
    rows, columns = np.nonzero(~in_view)
    box = (int(rows.min()), int(rows.max()) + 1), (int(columns.min()), int(columns.max()) + 1)
    if np.ptp(box[0]) * np.ptp(box[1]) <= in_view.size / 2:
        return f"that is at {_told(coverage, *box)}"
    rectangle = _rectangle(in_view)
    if rectangle is None:
        return "that is here and there"
    return f"wholly in view is {_told(coverage, *rectangle)}"


def _rectangle(in_view: NDArray[np.bool_]) -> tuple[tuple[int, int], tuple[int, int]] | None:
    """About the largest rectangle of squares, from and to along x and y, that is in view throughout."""
    # Sums over all rectangles that begin at the corner: any other's is four of them.
    sums = np.zeros((in_view.shape[0] + 1, in_view.shape[1] + 1), dtype=np.int64)
    sums[1:, 1:] = in_view.cumsum(axis=0).cumsum(axis=1)
    (x0, x1), (y0, y1) = (_pairs(size) for size in in_view.shape)
    inside = sums[np.ix_(x1, y1)] - sums[np.ix_(x0, y1)] - sums[np.ix_(x1, y0)] + sums[np.ix_(x0, y0)]
    area = np.outer(x1 - x0, y1 - y0)
    i, j = np.unravel_index((area * (inside == area)).argmax(), area.shape)
    if inside[i, j] < area[i, j]:
        return None
    return (int(x0[i]), int(x1[i])), (int(y0[j]), int(y1[j]))


def _pairs(size: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Where stretches of `size` squares begin and end."""
    steps = np.unique(np.linspace(0, size, BLOCKS + 1).astype(np.int64))
    first, last = np.triu_indices(len(steps), 1)
    return steps[first], steps[last]


def _told(coverage: Coverage, rows: tuple[int, int], columns: tuple[int, int]) -> str:
    words = []
    for name, (low, high), count, ends in (
        ("x", coverage.x_m, coverage.pictures.shape[0], rows),
        ("y", coverage.y_m, coverage.pictures.shape[1], columns),
    ):
        a, b = (low + end / count * (high - low) for end in ends)
        words.append(f"{name} {a:.2f} to {b:.2f} m")
    return ", ".join(words)
