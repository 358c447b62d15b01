"""Conversion of a bag to a recording, with one view for each position at which the arm stood still."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cell.bag.bag_file import Bag, open_bag
from cell.bag.depth_image import depth_counts, depth_unit, is_rectified
from cell.bag.errors import BagError
from cell.bag.frames import Frames, find_frames, fixed_camera
from cell.bag.intensity_images import find_intensity_topic, mean_intensities
from cell.bag.stationary import StationaryPose, StationaryPoses, find_stationary_poses
from cell.bag.survey import Survey, Topics, find_topics, survey
from cell.bag.tf_tree import nanoseconds
from cell.camera.frame_averaging import median
from cell.devices import InvalidViewError, View
from cell.recording import RecordingHeader
from cell.recording.errors import shown
from cell.recording.header import Box
from cell.recording.limits import DEFAULT_LIMITS
from cell.recording.whole_recording import require_new, write_whole


@dataclass(frozen=True, eq=False)
class BagRequest:
    """What the caller knows about a bag. None means that the value is found in the bag."""

    depth_topic: str | None = None
    info_topic: str | None = None
    intensity_topic: str | None = None
    base_frame: str | None = None
    flange_frame: str | None = None
    camera_frame: str | None = None
    depth_unit_m: float | None = None
    """Metres per count of 16UC1, and unit to which metres of 32FC1 are rounded."""
    rectified: bool = False
    """Whether the images are rectified although their topic's name does not say so."""
    T_flange_camera: NDArray[np.float64] | None = None
    """(4, 4) hand-eye calibration to be used instead of /tf."""
    hand_eye: str = "tf"
    """Source of `T_flange_camera`, for the provenance."""
    string_radius_m: float | None = None
    table_z_m: float = 0.0
    workspace_m: Box | None = None


@dataclass(frozen=True, eq=False)
class ImportedBag:
    """Result of `import_bag`."""

    topics: Topics
    frames: Frames
    stationary: StationaryPoses
    intensity_topic: str | None
    """Topic of the intensity images, or None without images that are aligned with the depth."""


def import_bag(path: Path, out: Path, request: BagRequest) -> ImportedBag:
    """Write the recording of a bag, completely or not at all.

    Args:
        path: The bag.
        out: The recording to write; it must not exist.
        request: What the caller knows about the bag.

    Raises:
        RecordingError: The bag cannot be used (BagError), `out` exists, or a value of `request` is impossible.
        NotRigidError: A pose is not rigid.
        InvalidViewError: A camera matrix is not valid.
        OSError: The recording cannot be written.
    """
    require_new(out)
    with open_bag(path) as bag:
        topics = find_topics(bag, request.depth_topic, request.info_topic)
        contents = survey(bag, topics, request.rectified or is_rectified(topics.depth))
        camera = request.camera_frame or contents.camera_frame
        frames = find_frames(contents.tree, request.base_frame, request.flange_frame, camera)
        stationary = find_stationary_poses(contents.tree.chain(frames.base, frames.flange), contents.stamps_ns)
        _check_count(stationary, len(contents.stamps_ns))
        T_flange_camera = request.T_flange_camera
        if T_flange_camera is None:
            taken_ns = contents.stamps_ns[[frame for pose in stationary.poses for frame in pose.frames]]
            T_flange_camera = fixed_camera(contents.tree, frames, taken_ns)
        intensity_topic = find_intensity_topic(bag, topics, contents, request.intensity_topic)
        provenance = _provenance(bag, topics, frames, stationary, contents.encoding, request.hand_eye)
        if intensity_topic is not None:
            provenance["intensity_topic"] = shown(intensity_topic)
        header = RecordingHeader(
            depth_unit_m=depth_unit(contents.encoding, request.depth_unit_m),
            string_radius_m=request.string_radius_m,
            T_flange_camera=T_flange_camera,
            table_z_m=request.table_z_m,
            workspace_m=request.workspace_m,
            provenance=provenance,
        )
        views = _views(bag, topics, contents, stationary, header)
        if intensity_topic is not None:
            views = _with_intensity(views, bag, intensity_topic, contents, stationary)
        write_whole(out, header, views)
    return ImportedBag(topics, frames, stationary, intensity_topic)


def _check_count(stationary: StationaryPoses, images: int) -> None:
    """Raise BagError for too few or too many views."""
    if 1 <= len(stationary.poses) <= DEFAULT_LIMITS.views:
        return
    count = len(stationary.poses)
    excluded = (
        f"of {images} depth images, {stationary.moving} were taken in motion, {stationary.unknown} have no known pose"
    )
    if count == 0:
        raise BagError(
            f"the arm stands still at {count} poses ({excluded}); at least one is needed: record eight, and keep the "
            "arm still for half a second or longer at each"
        )
    raise BagError(
        f"the arm stands still at {count} poses ({excluded}); at most {DEFAULT_LIMITS.views} are read: cut the bag"
    )


def _provenance(
    bag: Bag, topics: Topics, frames: Frames, stationary: StationaryPoses, encoding: str, hand_eye: str
) -> dict[str, str]:
    return {
        "source": f"ROS {bag.ros} bag",
        "bag": shown(bag.name),
        "depth_topic": shown(topics.depth),
        "depth_encoding": shown(encoding),
        "info_topic": shown(topics.info),
        "base_frame": shown(frames.base),
        "flange_frame": shown(frames.flange),
        "camera_frame": shown(frames.camera),
        "hand_eye": shown(hand_eye),
        "frames_per_view": " ".join(str(len(pose.frames)) for pose in stationary.poses),
    }


def _views(
    bag: Bag, topics: Topics, contents: Survey, stationary: StationaryPoses, header: RecordingHeader
) -> Iterator[View]:
    """Yield the views one after the other. If the bag is in order, only the images of one view are in memory."""
    pose_of = {int(contents.stamps_ns[frame]): k for k, pose in enumerate(stationary.poses) for frame in pose.frames}
    pending: dict[int, list[NDArray[np.uint16]]] = {}
    for _, image in bag.messages([topics.depth]):
        stamp_ns = nanoseconds(image.header.stamp)
        k = pose_of.pop(stamp_ns, None)  # a duplicate is used once
        if k is None:
            continue
        depth = depth_counts(image, header.depth_unit_m, f"{shown(topics.depth)}, image of {stamp_ns} ns")
        pending.setdefault(k, []).append(depth)
        if len(pending[k]) == len(stationary.poses[k].frames):
            yield _view(k, stationary.poses[k], median(pending.pop(k)), contents, header)


def _with_intensity(
    views: Iterator[View], bag: Bag, topic: str, contents: Survey, stationary: StationaryPoses
) -> Iterator[View]:
    """Yield the views with their intensity images. A view without images keeps none."""
    shape = (contents.intrinsics.height, contents.intrinsics.width)
    means = mean_intensities(bag, topic, stationary.poses, contents.stamps_ns, shape)
    for view in views:
        yield replace(view, intensity=means.get(view.index))


def _view(
    index: int, pose: StationaryPose, depth: NDArray[np.uint16], contents: Survey, header: RecordingHeader
) -> View:
    try:
        return View(
            index=index,
            depth=depth,
            depth_unit_m=header.depth_unit_m,
            K=contents.intrinsics.K,
            T_base_flange=pose.T_base_flange,
            T_flange_camera=header.T_flange_camera,
            stamp_s=pose.stamp_ns / 1e9,
        )
    except InvalidViewError as error:
        raise BagError(str(error)) from error
