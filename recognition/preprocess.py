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
    depth, T = view.depth, view.T_base_camera
    rows, columns = np.nonzero(depth)
    z = depth[rows, columns] * view.depth_unit_m
    points = transform_points(T, deproject(columns, rows, z, view.K))
    if scene.workspace_m is not None:
        low, high = np.asarray(scene.workspace_m, dtype=np.float64).T
        # The table's own surface scatters about the floor of the box: it counts as seen.
        low = low - (0.0, 0.0, MARGIN_M)
        points = points[((points >= low) & (points <= high)).all(axis=1)]
    T_levelling = levelling(points, scene.table_z_m, parameters)
    # Only what may pass the threshold is worth moving.
    candidates = points[points[:, 2] > scene.table_z_m + parameters.z_t - MARGIN_M]
    levelled = transform_points(T_levelling, candidates)
    return TargetCloud(
        view=view.index,
        points=levelled[levelled[:, 2] > scene.table_z_m + parameters.z_t],
        viewpoint=transform_points(T_levelling, T[:3, 3]),
        T_levelling=T_levelling,
        measured=len(z),
        in_workspace=len(points),
        constant=len(z) > 1 and bool((z == z[0]).all()),
    )


def deproject(
    u: NDArray[np.integer], v: NDArray[np.integer], z: NDArray[np.float64], K: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Camera points (N, 3) of the pixels (u, v) with depths z (N,), metres, by the pinhole model K."""
    return np.column_stack([(u - K[0, 2]) / K[0, 0] * z, (v - K[1, 2]) / K[1, 1] * z, z])
