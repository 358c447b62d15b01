"""Point clouds as a recording: a virtual depth image for each viewpoint."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cell.cloud.errors import CloudError
from cell.cloud.ply_file import Cloud, read_cloud
from cell.cloud.virtual_view import VirtualView, virtual_view
from cell.devices import View
from cell.frames.depth_file import fine_unit, to_counts
from cell.recording import RecordingHeader
from cell.recording.errors import shown
from cell.recording.header import Box
from cell.recording.limits import DEFAULT_LIMITS
from cell.recording.whole_recording import require_new, write_whole

VIEW_PROPERTY = "view"
"""Property that numbers the viewpoint of each point, where a file has it and no other is named."""
TABLE_M = (-0.01, 0.004)
"""Points between these heights above the table count as the table's. A string is higher."""
TABLE_SHARE = 0.2
"""Share of the points that must be the table's, or the views cannot be aligned to it."""
MARGIN_M = 0.02
"""Points up to this far outside the workspace are kept, as neighbours of those inside."""
BELOW_M = 0.05
"""Points up to this far below the table are kept."""
MIN_POINTS = 1000
"""Minimum number of points of a viewpoint."""
MERGED = "one merged file"
"""Name of the form in which the viewpoint of a point is unknown."""
MERGED_POINTS_PER_PIXEL = 8.0
"""Mean number of points in a pixel of a merged cloud, in which the points of several views overlap."""


@dataclass(frozen=True, eq=False)
class CloudRequest:
    """What the caller knows about the point clouds."""

    viewpoints_m: Sequence[Sequence[float]]
    """(V, 3) positions of the camera in the base frame."""
    view_property: str | None = None
    """Property of a merged file that numbers the viewpoint of each point; None: `view`, where the file has it."""
    string_radius_m: float | None = None
    """Radius of the strings, written into the recording; None: unknown."""
    table_z_m: float = 0.0
    """Height of the table in the base frame."""
    workspace_m: Box | None = None
    """Limits along x, y and z in the base frame that recognition works in; None: everything that was measured."""


@dataclass(frozen=True)
class ImportedCloud:
    """Result of `import_cloud`."""

    form: str
    """How the points were assigned to the viewpoints."""
    points: tuple[int, ...]
    """Number of points of each viewpoint, before hidden ones are removed."""
    hidden: tuple[int, ...]
    """Number of these that other points hide."""
    sizes: tuple[tuple[int, int], ...]
    """Width and height of each virtual image, pixels."""
    pitch_m: float
    """Largest width of a pixel at the median distance of the points."""
    depth_unit_m: float
    """Metres per depth count of the recording."""
    notes: tuple[str, ...]
    """Messages about what was ignored."""


def import_cloud(files: Sequence[Path], out: Path, request: CloudRequest) -> ImportedCloud:
    """Write the recording `out` from the point clouds in `files`, completely or not at all.

    Args:
        files: One PLY file for each viewpoint, in the order of the viewpoints, or one merged file.
        out: The recording to write; it must not exist.
        request: Viewpoints, and what the caller knows about the scene.

    Returns:
        The form of the clouds, the numbers of points, and the rounding.

    Raises:
        RecordingError: The clouds cannot be used (CloudError), `out` exists, or a value of `request` is impossible.
        OSError: The recording cannot be written.
    """
    require_new(out)
    viewpoints = _viewpoints(request)
    if len(files) not in (1, len(viewpoints)):
        raise CloudError(
            f"{len(files)} files and {len(viewpoints)} viewpoints are given: give one file for each viewpoint, or one "
            "merged file"
        )
    clouds, form, notes = _clouds(files, request, len(viewpoints))
    merged = len(clouds) < len(viewpoints)
    clouds = [_checked(points, request) for points in clouds]
    if merged:
        clouds *= len(viewpoints)
    per_pixel = MERGED_POINTS_PER_PIXEL if merged else 1.0
    views = [virtual_view(points, eye, per_pixel) for points, eye in zip(clouds, viewpoints, strict=True)]
    _check_spacing(views, request.string_radius_m)
    unit_m = fine_unit(max(float(view.depth_m.max()) for view in views))
    header = RecordingHeader(
        depth_unit_m=unit_m,
        string_radius_m=request.string_radius_m,
        T_flange_camera=np.eye(4),
        table_z_m=request.table_z_m,
        workspace_m=request.workspace_m,
        provenance={
            "source": "point clouds",
            "files": " ".join(shown(path.name) for path in files),
            "form": form,
            "views": "virtual depth images; the orientation and the camera matrix are chosen",
            "stamps": "none: view k has the stamp k s",
        },
    )
    write_whole(out, header, (_view(k, view, header) for k, view in enumerate(views)))
    return ImportedCloud(
        form=form,
        points=tuple(len(points) for points in clouds),
        hidden=tuple(view.hidden for view in views),
        sizes=tuple((view.depth_m.shape[1], view.depth_m.shape[0]) for view in views),
        pitch_m=max(view.pitch_m for view in views),
        depth_unit_m=unit_m,
        notes=notes,
    )


def _viewpoints(request: CloudRequest) -> NDArray[np.float64]:
    """Return the viewpoints (V, 3), checked."""
    viewpoints = np.array(request.viewpoints_m, dtype=np.float64).reshape(-1, 3)
    if not 1 <= len(viewpoints) <= DEFAULT_LIMITS.views:
        raise CloudError(
            f"{len(viewpoints)} viewpoints are given; from 1 to {DEFAULT_LIMITS.views} are needed: repeat "
            "--viewpoint for each position of the camera"
        )
    for viewpoint in viewpoints:
        named = f"the viewpoint ({', '.join(f'{value:g}' for value in viewpoint)})"
        if not np.isfinite(viewpoint).all():
            raise CloudError(f"{named} has NaN or infinity: give three numbers in metres")
        if viewpoint[2] <= request.table_z_m:
            raise CloudError(
                f"{named} is not above the table, z = {request.table_z_m:g} m: give positions in the base frame, whose "
                "z points up, and check --table-z"
            )
    if len(np.unique(viewpoints, axis=0)) < len(viewpoints):
        raise CloudError("two viewpoints are the same: give each position of the camera once")
    return viewpoints


def _clouds(
    files: Sequence[Path], request: CloudRequest, viewpoints: int
) -> tuple[list[NDArray[np.float64]], str, tuple[str, ...]]:
    """Return the points of each viewpoint, or of all together, how they were given, and what was ignored."""
    if len(files) > 1:
        if request.view_property is not None:
            raise CloudError("--view-property is for one merged file, and several files are given")
        read = [read_cloud(path) for path in files]
        return [cloud.points for cloud in read], "a file for each viewpoint", sum((c.notes for c in read), ())
    cloud = read_cloud(files[0], request.view_property, VIEW_PROPERTY)
    if cloud.views is None:
        return [cloud.points], MERGED, cloud.notes
    return _split(cloud, files[0], viewpoints), "one merged file with the viewpoint of each point", cloud.notes


def _split(cloud: Cloud, path: Path, viewpoints: int) -> list[NDArray[np.float64]]:
    assert cloud.views is not None
    numbers = np.unique(cloud.views)
    if not np.array_equal(numbers, np.arange(viewpoints)):
        raise CloudError(
            f"{path} numbers its viewpoints {', '.join(map(str, numbers[:10]))}; with {viewpoints} viewpoints given, "
            f"0 to {viewpoints - 1} are needed"
        )
    return [cloud.points[cloud.views == k] for k in range(viewpoints)]


def _checked(points: NDArray[np.float64], request: CloudRequest) -> NDArray[np.float64]:
    """Return the points in and around the workspace."""
    if request.workspace_m is not None:
        (x0, x1), (y0, y1), (_, z1) = request.workspace_m
        lowest = (x0 - MARGIN_M, y0 - MARGIN_M, request.table_z_m - BELOW_M)
        highest = (x1 + MARGIN_M, y1 + MARGIN_M, z1 + MARGIN_M)
        points = points[((points >= lowest) & (points <= highest)).all(axis=1)]
    if len(points) < MIN_POINTS:
        raise CloudError(
            f"a viewpoint has {len(points)} points (in the workspace); {MIN_POINTS} at least are needed: check the "
            "frame of the points, their unit and --workspace"
        )
    height = points[:, 2] - request.table_z_m
    share = float(np.mean((height > TABLE_M[0]) & (height < TABLE_M[1])))
    if share < TABLE_SHARE:
        raise CloudError(
            f"{share:.0%} of the points are at the table, z = {request.table_z_m:g} m, and {TABLE_SHARE:.0%} are "
            "needed to align the views to it: keep the table's points, and check --table-z and the points' frame"
        )
    return points


def _check_spacing(views: Sequence[VirtualView], radius_m: float | None) -> None:
    """Refuse points too far apart to show the string."""
    pitch_m = max(view.pitch_m for view in views)
    if radius_m is not None and pitch_m > radius_m:
        raise CloudError(
            f"the points are too sparse: a pixel would be {pitch_m * 1000:.1f} mm wide, more than the string radius of "
            f"{radius_m * 1000:.1f} mm; give clouds that are not thinned"
        )


def _view(index: int, view: VirtualView, header: RecordingHeader) -> View:
    return View(
        index=index,
        depth=to_counts(view.depth_m, 1.0, header.depth_unit_m),
        depth_unit_m=header.depth_unit_m,
        K=view.K,
        T_base_flange=view.T_base_camera,
        T_flange_camera=header.T_flange_camera,
        stamp_s=float(index),
    )
