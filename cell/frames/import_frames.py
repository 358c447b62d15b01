"""A folder of depth images as a recording: a view for each image."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from calibration.geometry.transforms import from_quaternion, to_quaternion
from cell.devices import InvalidViewError, View
from cell.frames.camera_file import Intrinsics, read_intrinsics
from cell.frames.depth_file import MAX_COUNT, fine_unit, measured, read_depth, to_counts
from cell.frames.errors import FramesError
from cell.frames.folder import depth_images
from cell.frames.intensity_file import read_intensities
from cell.frames.pose_files import read_poses
from cell.frames.table_fit import (
    Frames,
    check_poses,
    fitting_units,
    guess_unit,
    share_on_table,
    table_offset_m,
    table_units,
)
from cell.recording import RecordingHeader
from cell.recording.errors import shown
from cell.recording.header import Box
from cell.recording.whole_recording import require_new, write_whole

NEIGHBOURS = 5000
"""Number of matrices that `encodable` tries; enough for each of 152 poses of recordings."""


@dataclass(frozen=True, eq=False)
class FramesRequest:
    """What the caller knows about the depth images."""

    T_flange_camera: NDArray[np.float64] | None = None
    """(4, 4) hand-eye calibration. The poses are then T_base_flange; None: they are T_base_camera."""
    hand_eye: str = "none: the poses are the camera's"
    """Where `T_flange_camera` comes from, for the recording's metadata."""
    intrinsics: tuple[float, float, float, float] | None = None
    """fx, fy, cx, cy in pixels; None: read from `camera.json` or `K.json`."""
    depth_unit_m: float | None = None
    """Metres per count, or per unit of floats; None: read from `camera.json`, else guessed."""
    string_radius_m: float | None = None
    """Radius of the strings, written into the recording; None: unknown."""
    table_z_m: float = 0.0
    """Height of the table in the base frame."""
    workspace_m: Box | None = None
    """Limits along x, y and z in the base frame that recognition works in; None: everything that was measured."""
    intensity: Path | None = None
    """Folder with an intensity image for each depth image, of the same name and as 8-bit grey PNG; None: there are
    none."""


@dataclass(frozen=True)
class ImportedFrames:
    """Result of `import_frames`."""

    views: int
    width: int
    height: int
    poses: str
    """Where the poses come from."""
    pose_name: str
    intrinsics: str
    """Where K comes from."""
    unit_m: float
    """Metres per count, or per unit of floats, of the images."""
    unit_source: str
    """`given`, `camera.json` or `guessed`; a contradiction between the first two is named."""
    table_share: float
    """Share of the measured pixels that are at the table's height."""
    better_unit_m: float | None
    """Customary unit that puts the table where the poses say it is, if `unit_m` does not."""
    table_offset_m: float | None
    """How far the images show the table above `table_z_m`; None: it cannot be measured."""
    recording_unit_m: float
    """Metres per count of the recording; equal to `unit_m` where counts are kept."""
    too_far: int
    """Number of pixels whose depth exceeds the recording's 16 bits; they have no depth there."""


def import_frames(folder: Path, out: Path, request: FramesRequest) -> ImportedFrames:
    """Write the recording `out` from the depth images in `folder`, completely or not at all.

    Args:
        folder: Depth images, poses and camera matrix.
        out: The recording to write; it must not exist.
        request: What the caller knows about the images.

    Returns:
        What was found in the folder and what was guessed.

    Raises:
        RecordingError: The folder cannot be used (FramesError), `out` exists, or a value of `request` is impossible.
        OSError: The recording cannot be written.
    """
    require_new(out)
    images = depth_images(folder)
    intrinsics = read_intrinsics(folder, request.intrinsics)
    pose_name = "T_base_camera" if request.T_flange_camera is None else "T_base_flange"
    poses, source = read_poses(folder, images, pose_name)
    values = [read_depth(path) for path in images]
    _check_alike(images, values, intrinsics)
    T_pose_camera = np.eye(4) if request.T_flange_camera is None else request.T_flange_camera
    frames = Frames(values, intrinsics.K, poses, pose_name, T_pose_camera, [path.name for path in images])
    units = table_units(frames, request.table_z_m)
    unit_m, unit_source = _unit(frames, request, intrinsics, units)
    recording_unit_m = _recording_unit(values, unit_m)
    height, width = values[0].shape
    intensities: list[NDArray[np.uint8]] | None = None
    if request.intensity is not None:
        intensities = read_intensities(request.intensity, [path.stem for path in images], (height, width))
    header = RecordingHeader(
        depth_unit_m=recording_unit_m,
        string_radius_m=request.string_radius_m,
        T_flange_camera=T_pose_camera,
        table_z_m=request.table_z_m,
        workspace_m=request.workspace_m,
        provenance={
            "source": "depth images",
            "folder": shown(folder.resolve().name),
            "images": f"{len(images)} {images[0].suffix.lower().removeprefix('.')} of {values[0].dtype}",
            "depth_unit": f"{unit_m:g} m, {unit_source}",
            "intrinsics": intrinsics.source,
            "poses": f"{pose_name}, {source}",
            "hand_eye": shown(request.hand_eye),
            "stamps": "none: view k has the stamp k s",
        },
    )
    depths = [to_counts(each, unit_m, recording_unit_m) for each in values]
    write_whole(out, header, _views(frames, depths, intensities, header))
    lost = sum(int(np.count_nonzero(measured(a) & (b == 0))) for a, b in zip(values, depths, strict=True))
    fitting = fitting_units(frames, units)
    return ImportedFrames(
        views=len(images),
        width=width,
        height=height,
        poses=source,
        pose_name=pose_name,
        intrinsics=intrinsics.source,
        unit_m=unit_m,
        unit_source=unit_source,
        table_share=share_on_table(units, unit_m),
        better_unit_m=fitting[0] if len(fitting) == 1 and not np.isclose(fitting[0], unit_m, rtol=0.1) else None,
        table_offset_m=table_offset_m(frames, request.table_z_m, unit_m),
        recording_unit_m=recording_unit_m,
        too_far=lost,
    )


def encodable(T: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a pose (4, 4) that a reader of the recording gets back as `T`, to the last bit if possible.

    Recordings hold rotations as quaternions. The conversion from a matrix to a quaternion and back changes the last
    bits of most matrices, so the neighbours of `T` are tried until one is converted to `T`.
    """
    if np.array_equal(from_quaternion(T[:3, 3], to_quaternion(T), "the pose"), T):
        return T
    R = T[:3, :3]
    steps = np.random.default_rng(0).integers(-4, 5, size=(NEIGHBOURS, 3, 3))
    near = R + np.spacing(np.abs(R)) * steps
    read = Rotation.from_quat(Rotation.from_matrix(near).as_quat()).as_matrix()
    exact = np.flatnonzero((read == R).all(axis=(1, 2)))
    if len(exact) == 0:
        return T
    result = T.copy()
    result[:3, :3] = near[exact[0]]
    return result


def _check_alike(images: list[Path], values: list[NDArray[np.generic]], intrinsics: Intrinsics) -> None:
    """Refuse images of different sizes or types, and a camera matrix of another size."""
    for path, each in zip(images, values, strict=True):
        if each.shape != values[0].shape:
            (h, w), (h0, w0) = each.shape, values[0].shape
            raise FramesError(
                f"{path} has {w}x{h} pixels, {images[0].name} {w0}x{h0}: all depth images must be of one camera"
            )
        if each.dtype.kind != values[0].dtype.kind and "f" in (each.dtype.kind, values[0].dtype.kind):
            raise FramesError(
                f"{path} holds {each.dtype}, {images[0].name} {values[0].dtype}: integers and floats have different "
                "units; save all images in one type"
            )
    height, width = values[0].shape
    if intrinsics.size is not None and intrinsics.size != (width, height):
        raise FramesError(
            f"{intrinsics.source} is for images of {intrinsics.size[0]}x{intrinsics.size[1]} pixels, the depth images "
            f"have {width}x{height}: give the camera matrix of this size"
        )
    cx, cy = intrinsics.K[0, 2], intrinsics.K[1, 2]
    if not (0 < cx < width and 0 < cy < height):
        raise FramesError(
            f"{intrinsics.source} has the image centre at ({cx:g}, {cy:g}), outside the depth images of "
            f"{width}x{height} pixels: give the camera matrix of this size"
        )


def _unit(
    frames: Frames, request: FramesRequest, intrinsics: Intrinsics, units: NDArray[np.float64]
) -> tuple[float, str]:
    """Return metres per count or unit, and how it is known; refuse poses that contradict the images."""
    unit_m, source = request.depth_unit_m, "given"
    if unit_m is None and intrinsics.depth_unit_m is not None:
        unit_m, source = intrinsics.depth_unit_m, intrinsics.source
    elif intrinsics.depth_unit_m not in (None, unit_m):
        source = f"given, though {intrinsics.source} has {intrinsics.depth_unit_m:g} m"
    if unit_m is not None and not (np.isfinite(unit_m) and unit_m > 0):
        raise FramesError(f"the depth unit is {unit_m:g}; metres per count are needed, as 0.001")
    check_poses(frames, request.table_z_m, unit_m, units)
    return (unit_m, source) if unit_m is not None else (guess_unit(frames, request.table_z_m, units), "guessed")


def _recording_unit(values: list[NDArray[np.generic]], unit_m: float) -> float:
    """Return the unit of the images if the recording can have it, else a fine one."""
    largest = max(float(each[measured(each)].max()) for each in values)
    if values[0].dtype.kind in "iu" and largest <= MAX_COUNT:
        return unit_m
    return fine_unit(largest * unit_m)


def _views(
    frames: Frames,
    depths: list[NDArray[np.uint16]],
    intensities: list[NDArray[np.uint8]] | None,
    header: RecordingHeader,
) -> Iterator[View]:
    for k, depth in enumerate(depths):
        try:
            yield View(
                index=k,
                depth=depth,
                depth_unit_m=header.depth_unit_m,
                K=frames.K,
                T_base_flange=encodable(frames.poses[k]),
                T_flange_camera=header.T_flange_camera,
                stamp_s=float(k),
                intensity=None if intensities is None else intensities[k],
            )
        except InvalidViewError as error:
            raise FramesError(f"{frames.names[k]}: {error}") from error
