"""From depth images to target point clouds: deprojection, workspace and height threshold (sections II.A, II.B)."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from calibration.geometry.transforms import transform_points
from recognition.errors import RecognitionError
from recognition.parameters import ChainParameters
from recognition.preprocessing.flying_pixels import is_on_surface
from recognition.preprocessing.table_plane import SAMPLE, table_alignment

MARGIN_M = 0.01
"""How far below the workspace's floor the table's own surface may scatter and still counts as seen."""
REACH_M = 100.0
"""Points farther than this from the base frame's origin are no arm's, and no workspace reaches them."""


class DepthView(Protocol):
    """Protocol of a view: any object with these five attributes. `cell.devices.View` is one."""

    @property
    def index(self) -> int:
        """Number of the view, different for each view."""
        ...

    @property
    def depth(self) -> NDArray[np.uint16]:
        """(H, W) depth along the optical axis in units of `depth_unit_m`; 0 = not measured."""
        ...

    @property
    def depth_unit_m(self) -> float:
        """Metres per depth count."""
        ...

    @property
    def K(self) -> NDArray[np.float64]:
        """(3, 3) pinhole matrix of the rectified depth image, pixels."""
        ...

    @property
    def T_base_camera(self) -> NDArray[np.float64]:
        """(4, 4) camera pose; maps camera points (x right, y down, z forward) to the base frame, metres."""
        ...


class InvalidSceneError(RecognitionError):
    """The table height or the workspace is not valid."""

    slug = "invalid-scene"


@dataclass(frozen=True)
class Scene:
    """The table and the workspace, in the base frame.

    Raises:
        InvalidSceneError: The height is not finite, or the workspace is not a box.
    """

    table_z_m: float = 0.0
    """Height of the table plane, metres. The z_w of the paper is measured from it."""
    workspace_m: tuple[tuple[float, float], tuple[float, float], tuple[float, float]] | None = None
    """Box ((x0, x1), (y0, y1), (z0, z1)), metres. Points outside are ignored. None means no limit."""

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
    T_base_camera: NDArray[np.float64]
    """(4, 4) where the camera was, levelled."""
    T_levelling: NDArray[np.float64]
    """(4, 4) correction that brought the table this view sees to its known height and tilt."""
    measured: int
    """Pixels with a depth."""
    in_workspace: int
    """Of these, points in the workspace, the table's among them (in large images counted on a sample)."""
    constant: bool
    """Every measured pixel has the same depth, as from a broken sensor."""
    image: DepthView | None = None
    """Where it comes from."""


def preprocess(view: DepthView, parameters: ChainParameters, scene: Scene) -> TargetCloud:
    """The points of one view that lie higher than z_t above the table, within the workspace.

    The view is levelled first (`recognition.preprocessing.table_plane`), on a sample of its points. Then the height of
    every pixel decides, and what is left is freed of rims (`recognition.preprocessing.flying_pixels`). Points of height
    are all that is kept: the paper removes "floor and experimental equipment" by the threshold on z_w alone.
    """
    depth = view.depth
    step = int(np.ceil(np.sqrt(max(depth.size / SAMPLE, 1.0))))
    rows, columns = (a.ravel() for a in np.mgrid[step // 2 : depth.shape[0] : step, step // 2 : depth.shape[1] : step])
    taken = depth[rows, columns] > 0
    sample = deproject(view, rows[taken], columns[taken])
    sample = sample[_inside(sample, scene)]
    T_levelling = table_alignment(sample, scene.table_z_m, parameters)
    T_base_camera = T_levelling @ view.T_base_camera

    rows, columns = _above(view, T_base_camera, scene.table_z_m + parameters.z_t)
    points = transform_points(T_levelling, deproject(view, rows, columns))
    kept = _inside(points, scene)
    kept[kept] = is_on_surface(view, rows[kept], columns[kept], parameters)
    measured = int(np.count_nonzero(depth))
    return TargetCloud(
        view=view.index,
        points=points[kept],
        T_base_camera=T_base_camera,
        T_levelling=T_levelling,
        measured=measured,
        in_workspace=min(len(sample) * step**2, measured),
        constant=measured > 1 and int(depth.max()) == int(depth[depth > 0].min()),
        image=view,
    )


def deproject(view: DepthView, rows: NDArray[np.intp], columns: NDArray[np.intp]) -> NDArray[np.float64]:
    """(N, 3) base coordinates of the given pixels (N,), metres, by the pinhole model.

    `depth (R K^-1) (u, v, 1) + t`, with T_base_camera = (R, t).
    """
    pixels = np.column_stack([columns, rows, np.ones(len(rows))])
    z = view.depth[rows, columns] * view.depth_unit_m
    T = view.T_base_camera
    return (T[:3, :3] @ np.linalg.inv(view.K) @ (z[:, None] * pixels).T).T + T[:3, 3]


def _above(
    view: DepthView, T_base_camera: NDArray[np.float64], height_m: float
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Rows and columns (N,) of the measured pixels that are higher than `height_m` in the base frame.

    A tenth of a micrometre, which single precision leaves, decides nothing, and a megapixel takes half the time.
    """
    rows, columns = (np.arange(n) for n in view.depth.shape)
    a, b, c = (T_base_camera[2, :3] @ np.linalg.inv(view.K)) * view.depth_unit_m
    with np.errstate(over="ignore", invalid="ignore"):
        heights = np.add.outer((b * rows + c).astype(np.float32), (a * columns).astype(np.float32))
        heights *= view.depth
        above = heights > np.float32(height_m - T_base_camera[2, 3])
    v, u = np.nonzero(above & (view.depth > 0))
    return v, u


def _inside(points: NDArray[np.float64], scene: Scene) -> NDArray[np.bool_]:
    """(N,) which of the points (N, 3) are in the workspace, the table's own surface counted in."""
    box = np.array([[-REACH_M, REACH_M]] * 3 if scene.workspace_m is None else scene.workspace_m)
    box[2, 0] -= MARGIN_M
    return np.all((points >= box[:, 0]) & (points <= box[:, 1]), axis=1)
