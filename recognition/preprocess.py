"""From depth images to target point clouds: deprojection, workspace and height threshold (sections II.A, II.B)."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from calibration.transforms import transform_points
from recognition.errors import RecognitionError
from recognition.parameters import ChainParameters
from recognition.table import levelling

MARGIN_M = 0.01
"""How far a point may be off by its view's pose: so much more is looked at before the view is levelled."""


class DepthView(Protocol):
    """What recognition needs of a view; `cell.devices.View` is one."""

    @property
    def index(self) -> int: ...
    @property
    def depth(self) -> NDArray[np.uint16]: ...
    @property
    def depth_unit_m(self) -> float: ...
    @property
    def K(self) -> NDArray[np.float64]: ...
    @property
    def T_base_camera(self) -> NDArray[np.float64]: ...


class InvalidSceneError(RecognitionError):
    """A table height or workspace that cannot be."""

    slug = "invalid-scene"


@dataclass(frozen=True)
class Scene:
    """Where to look."""

    table_z_m: float = 0.0
    """Height of the table plane in the base frame; the paper's z_w is measured from it."""
    workspace_m: tuple[tuple[float, float], tuple[float, float], tuple[float, float]] | None = None
    """Box ((x0, x1), (y0, y1), (z0, z1)) in the base frame; points outside are not looked at. None: everywhere."""

    def __post_init__(self) -> None:
        if not np.isfinite(self.table_z_m):
            raise InvalidSceneError(f"table_z_m is {self.table_z_m!r}; a finite height in metres is needed")
        if self.workspace_m is None:
            return
        box = np.asarray(self.workspace_m, dtype=np.float64)
        if box.shape != (3, 2) or not np.isfinite(box).all() or not (box[:, 0] < box[:, 1]).all():
            raise InvalidSceneError(
                f"workspace_m is {self.workspace_m!r}; [[x0, x1], [y0, y1], [z0, z1]] with x0 < x1 and so on is needed"
            )


@dataclass(frozen=True, eq=False)
class TargetCloud:
    """The target point cloud of one view."""

    view: int
    """The view's index."""
    points: NDArray[np.float64]
    """(N, 3) points of string height, base frame by the hand-eye pose, levelled."""
    viewpoint: NDArray[np.float64]
    """(3,) where the camera was, base frame, levelled."""
    T_levelling: NDArray[np.float64]
    """(4, 4) correction that brought the table this view sees to its known height and tilt."""
    measured: int
    """Pixels with a depth."""
    in_workspace: int
    """Of these, points in the workspace, the table's among them."""
    constant: bool
    """Every measured pixel has the same depth, as from a broken sensor."""


def preprocess(view: DepthView, parameters: ChainParameters, scene: Scene) -> TargetCloud:
    """The points of one view that lie higher than z_t above the table, within the workspace.

    The view is levelled first (`recognition.table`).

    Points of height are all that is kept: the paper removes "floor and experimental equipment" by the
    threshold on z_w alone.
    """
    T = view.T_base_camera
    measured = int(np.count_nonzero(view.depth))
    points = _in_workspace(view, scene)
    T_levelling = levelling(points, scene.table_z_m, parameters)
    height = points @ T_levelling[2, :3] + T_levelling[2, 3] - scene.table_z_m
    return TargetCloud(
        view=view.index,
        points=transform_points(T_levelling, points[height > parameters.z_t]),
        viewpoint=transform_points(T_levelling, T[:3, 3]),
        T_levelling=T_levelling,
        measured=measured,
        in_workspace=len(points),
        constant=measured > 1 and int(view.depth.max()) == int(view.depth[view.depth > 0].min()),
    )


def deproject(view: DepthView) -> NDArray[np.float64]:
    """(3, H, W) base coordinates of every pixel, metres, by the pinhole model; where depth is 0 the camera's own.

    `depth (R K^-1) (u, v, 1) + t`, with T_base_camera = (R, t): one row of sums and one product a coordinate.
    """
    height, width = view.depth.shape
    T = view.T_base_camera
    A = T[:3, :3] @ np.linalg.inv(view.K)
    u, v = np.arange(width), np.arange(height)[:, None]
    z = view.depth * view.depth_unit_m
    return np.stack([z * (a[0] * u + (a[1] * v + a[2])) + t for a, t in zip(A, T[:3, 3], strict=True)])


def _in_workspace(view: DepthView, scene: Scene) -> NDArray[np.float64]:
    """(N, 3) measured points of the view in the workspace, base frame."""
    coordinates = deproject(view)
    inside = view.depth > 0
    if scene.workspace_m is not None:
        # The table's own surface scatters about the floor of the box: it counts as seen.
        margins = (0.0, 0.0, MARGIN_M)
        for values, (low, high), margin in zip(coordinates, scene.workspace_m, margins, strict=True):
            inside &= (values >= low - margin) & (values <= high)
    return coordinates[:, inside].T
