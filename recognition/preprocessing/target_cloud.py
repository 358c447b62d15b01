"""Target point cloud of a view: deprojection, workspace and height threshold (sections II.A, II.B)."""

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from calibration.geometry.transforms import transform_points
from recognition.errors import InvalidSceneError
from recognition.parameters import ChainParameters
from recognition.preprocessing.flying_pixels import is_on_surface
from recognition.preprocessing.table_plane import SAMPLE_SIZE, table_alignment
from recognition.preprocessing.table_scatter import TableScatter, max_scatter_m, patch_pixels, table_scatter

FLOOR_MARGIN_M = 0.01
"""Margin below the floor of the workspace, metres. Noisy table points within the margin count as inside."""
MAX_REACH_M = 100.0
"""Limit of a scene without a workspace along each axis of the base frame, metres. No arm reaches farther."""


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


def intensity_of(view: DepthView) -> NDArray[np.uint8] | None:
    """Return the intensity image (H, W) of a view, aligned with its depth pixel for pixel, or None if it has none.

    A view needs no such image, so that `intensity` is no member of the protocol.
    """
    return getattr(view, "intensity", None)


@dataclass(frozen=True)
class Scene:
    """The table and the workspace, in the base frame.

    Raises:
        InvalidSceneError: The height is not finite, or the workspace is not a box.
    """

    table_z_m: float = 0.0
    """Height of the table plane, metres. The paper measures z_w from this plane."""
    workspace_m: tuple[tuple[float, float], tuple[float, float], tuple[float, float]] | None = None
    """Box ((x0, x1), (y0, y1), (z0, z1)), metres. Points outside the box are ignored. None means no limit."""

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

    def is_near_border(self, point: NDArray[np.float64], margin_m: float) -> bool:
        """Return whether a point is outside the workspace or near its sides or top. The floor is not checked.

        Args:
            point: (3,) position in the base frame, metres.
            margin_m: Maximum distance of a near point from the sides or the top, metres.

        Returns:
            True if the point is near or outside. Always False in a scene without a workspace.
        """
        if self.workspace_m is None:
            return False
        low, high = np.asarray(self.workspace_m, dtype=np.float64).T
        return bool((point[:2] < low[:2] + margin_m).any() or (point > high - margin_m).any())


@dataclass(frozen=True, eq=False)
class TargetCloud:
    """Target point cloud of one view: points in the workspace at more than z_t above the table."""

    view: int
    """Index of the view."""
    points: NDArray[np.float64]
    """(N, 3) points in the base frame, metres."""
    T_base_camera: NDArray[np.float64]
    """(4, 4) camera pose after the alignment to the table plane, metres."""
    T_table_alignment: NDArray[np.float64]
    """(4, 4) correction that aligns the view to the table plane, base to base, metres."""
    n_measured: int
    """Number of pixels with a depth."""
    n_in_workspace: int
    """Number of measured pixels in the workspace, including the table, estimated from a sample in a large image."""
    constant_depth: bool
    """True if all measured pixels (at least two) have the same depth, as in the images of a defective sensor."""
    image: DepthView | None = None
    """View that the points come from, without the errors of its camera; None if unknown."""
    scatter: TableScatter = field(default_factory=TableScatter)
    """Scatter of the depth, measured on the table."""
    n_below: int = 0
    """Number of points that the same selection gives as far below the table. Noise gives as many above it. Only counted
    if the scatter of single pixels exceeds its limit, else 0."""
    threshold_m: float = 0.0
    """Height threshold z_t above the table, metres; 0 if unknown."""


@dataclass(frozen=True, eq=False)
class AlignedView:
    """A view that is aligned to the table plane."""

    view: DepthView
    """Depth image with its pose before the alignment."""
    T_table_alignment: NDArray[np.float64]
    """(4, 4) correction that aligns the view to the table plane, base to base, metres."""
    parameters: ChainParameters
    """Method parameters."""
    scene: Scene
    """Table height and workspace."""
    scatter: TableScatter
    """Scatter of the depth, measured on the table."""
    n_measured: int
    """Number of pixels with a depth."""
    n_in_workspace: int
    """Number of them in the workspace, estimated from a sample in a large image."""
    pixels_per_m: float
    """Resolution of the image at the usual depth, 0 without a depth."""

    @property
    def T_base_camera(self) -> NDArray[np.float64]:
        """(4, 4) camera pose after the alignment, metres."""
        return self.T_table_alignment @ self.view.T_base_camera


def preprocess(view: DepthView, parameters: ChainParameters, scene: Scene) -> TargetCloud:
    """Return the points of one view in the workspace at more than z_t above the table.

    First, a sample of the points aligns the view to the table plane. Then the height threshold selects pixels. Last, a
    filter removes flying pixels at depth discontinuities.

    Args:
        view: Depth image with its camera pose.
        parameters: Method parameters; uses the radius r and the height threshold z_t.
        scene: Table height and workspace.

    Returns:
        The target cloud. It may be empty.

    Source:
        Sections II.A and II.B. The paper removes "floor and experimental equipment" by the threshold on z_w alone.
        The alignment to the table plane and the filter of flying pixels are not in the paper.
    """
    return select_target(align_view(view, parameters, scene))


def align_view(view: DepthView, parameters: ChainParameters, scene: Scene) -> AlignedView:
    """Align a view to the table plane, and measure the scatter of its depth on the table.

    Args:
        view: Depth image with its camera pose.
        parameters: Method parameters; uses the radius r and the height threshold z_t.
        scene: Table height and workspace.
    """
    depth = view.depth
    step = int(np.ceil(np.sqrt(max(depth.size / SAMPLE_SIZE, 1.0))))
    rows, columns = (a.ravel() for a in np.mgrid[step // 2 : depth.shape[0] : step, step // 2 : depth.shape[1] : step])
    measured = depth[rows, columns] > 0
    sample = deproject(view, rows[measured], columns[measured])
    sample = sample[is_in_workspace(sample, scene)]
    T_table_alignment = table_alignment(sample, scene.table_z_m, parameters)
    is_aligned = not np.array_equal(T_table_alignment, np.eye(4))
    table_points = transform_points(T_table_alignment, sample)
    distance_m = np.inf
    if measured.any():
        distance_m = float(np.median(depth[rows[measured], columns[measured]])) * view.depth_unit_m
    pixels_per_m = float(view.K[0, 0]) / distance_m
    patches = _patches(view, T_table_alignment, parameters, scene, pixels_per_m)
    n_measured = int(np.count_nonzero(depth))
    return AlignedView(
        view=view,
        T_table_alignment=T_table_alignment,
        parameters=parameters,
        scene=scene,
        scatter=table_scatter(table_points, patches, scene.table_z_m, parameters, is_aligned),
        n_measured=n_measured,
        n_in_workspace=min(len(sample) * step**2, n_measured),
        pixels_per_m=pixels_per_m,
    )


def select_target(aligned: AlignedView, image: DepthView | None = None, compression: float = 1.0) -> TargetCloud:
    """Return the points of an aligned view in the workspace at more than z_t above the table.

    Args:
        aligned: View aligned to the table plane.
        image: The same view with restored heights. None means that nothing is restored.
        compression: Compression of the heights that was restored.
    """
    view = aligned.view
    depth = view.depth
    parameters = aligned.parameters
    image = image or view
    points = _points_beyond(aligned, image, parameters.z_t, 1)
    n_below = 0
    if aligned.scatter.pixel_m > max_scatter_m(parameters):
        # noise above the table was enlarged with all heights, but not the noise below it
        n_below = len(_points_beyond(aligned, view, compression * parameters.z_t, -1))
    return TargetCloud(
        view=view.index,
        points=points,
        T_base_camera=aligned.T_base_camera,
        T_table_alignment=aligned.T_table_alignment,
        n_measured=aligned.n_measured,
        n_in_workspace=aligned.n_in_workspace,
        constant_depth=aligned.n_measured > 1 and int(depth.max()) == int(depth[depth > 0].min()),
        image=image,
        scatter=aligned.scatter,
        n_below=n_below,
        threshold_m=parameters.z_t,
    )


def deproject(view: DepthView, rows: NDArray[np.intp], columns: NDArray[np.intp]) -> NDArray[np.float64]:
    """Deproject pixels to the base frame by the pinhole model: `depth (R K^-1) (u, v, 1) + t`.

    Args:
        view: Depth image with its camera pose `T_base_camera = (R, t)`.
        rows: (N,) rows v of the pixels.
        columns: (N,) columns u of the pixels.

    Returns:
        Points (N, 3), metres, base frame. A pixel without a depth gives the position of the camera.

    Source:
        Section II.A.
    """
    pixels = np.column_stack([columns, rows, np.ones(len(rows))])
    z = view.depth[rows, columns] * view.depth_unit_m
    T = view.T_base_camera
    return (T[:3, :3] @ np.linalg.inv(view.K) @ (z[:, None] * pixels).T).T + T[:3, 3]


def workspace_box(scene: Scene) -> NDArray[np.float64]:
    """Return the limits (3, 2) of the workspace along x, y and z, metres; `MAX_REACH_M` if there is no workspace."""
    if scene.workspace_m is None:
        return np.tile([-MAX_REACH_M, MAX_REACH_M], (3, 1))
    return np.array(scene.workspace_m, dtype=np.float64)


def _patches(
    view: DepthView,
    T_table_alignment: NDArray[np.float64],
    parameters: ChainParameters,
    scene: Scene,
    pixels_per_m: float,
) -> NDArray[np.float64]:
    """Return points (M, n, 3) of patches as wide as a string, not a number where nothing in the workspace is measured.

    The errors of neighbouring pixels are similar. An even sample of the image has too few pixels in a patch to show it.
    `pixels_per_m` is the resolution at the usual depth in the image.
    """
    edge_px = 2 * parameters.r * pixels_per_m
    rows, columns = patch_pixels(view.depth.shape, edge_px)
    points = deproject(view, rows.ravel(), columns.ravel())
    usable = (view.depth[rows, columns].ravel() > 0) & is_in_workspace(points, scene)
    points = transform_points(T_table_alignment, points)
    points[~usable] = np.nan
    return points.reshape(*rows.shape, 3)


def _points_beyond(aligned: AlignedView, image: DepthView, distance_m: float, side: int) -> NDArray[np.float64]:
    """Return the points (N, 3) on a surface at more than a distance above the table, or below it if `side` is -1.

    The workspace is mirrored for the points below.
    """
    table_z_m = aligned.scene.table_z_m
    rows, columns = _pixels_beyond(image, aligned.T_base_camera, table_z_m + side * distance_m, side)
    points = transform_points(aligned.T_table_alignment, deproject(image, rows, columns))
    mirrored = points
    if side < 0:
        mirrored = points * (1.0, 1.0, -1.0) + (0.0, 0.0, 2 * table_z_m)
    kept = is_in_workspace(mirrored, aligned.scene)
    kept[kept] = is_on_surface(image, rows[kept], columns[kept], aligned.parameters)
    return points[kept]


def _pixels_beyond(
    view: DepthView, T_base_camera: NDArray[np.float64], height_m: float, side: int
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the rows (N,) and columns (N,) of the measured pixels above a height, or below it if `side` is -1.

    `height_m` is in metres, in the base frame.
    """
    rows, columns = (np.arange(n) for n in view.depth.shape)
    a, b, c = (T_base_camera[2, :3] @ np.linalg.inv(view.K)) * view.depth_unit_m
    # Single precision rounds heights by a tenth of a micrometre and halves the time for a megapixel.
    with np.errstate(over="ignore", invalid="ignore"):
        heights = np.add.outer((b * rows + c).astype(np.float32), (a * columns).astype(np.float32))
        heights *= view.depth
        limit = np.float32(height_m - T_base_camera[2, 3])
        is_beyond = heights > limit if side > 0 else heights < limit
    v, u = np.nonzero(is_beyond & (view.depth > 0))
    return v, u


def is_in_workspace(points: NDArray[np.float64], scene: Scene) -> NDArray[np.bool_]:
    """Return the mask (N,) of the points (N, 3) in the workspace, with a margin of `FLOOR_MARGIN_M` below the floor."""
    low, high = workspace_box(scene).T
    low[2] -= FLOOR_MARGIN_M
    return np.all((points >= low) & (points <= high), axis=1)
