"""Intensity images of a bag that are aligned with its depth images, for example the left infrared images."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from cell.bag.bag_file import CAMERA_INFO, IMAGE, Bag
from cell.bag.depth_image import intrinsics_of, is_rectified
from cell.bag.errors import BagError, listed
from cell.bag.stationary import StationaryPose
from cell.bag.survey import Survey, Topics
from cell.bag.tf_tree import frame_name, nanoseconds
from cell.recording.errors import shown

ENCODINGS = ("mono8", "8UC1")
SAME_K_PX = 0.05
"""Largest difference between the camera matrices of aligned images."""
SAME_CAMERA_M = 1e-4
SAME_CAMERA_RAD = 1e-4
"""Largest distance and angle between the frames of aligned images."""
SLACK_NS = 50_000_000
"""Time by which an image may differ from the depth images of its view. The arm stands still for longer."""
MAX_IMAGES = 200
"""Largest number of images of one view, so that their sum has 16 bits."""


def find_intensity_topic(bag: Bag, topics: Topics, contents: Survey, given: str | None) -> str | None:
    """Return the given topic, or the first one whose images are aligned with the depth images, or None.

    Args:
        bag: The bag.
        topics: Topics of the depth images.
        contents: Camera matrix and frame of the depth images.
        given: Topic of the intensity images, or None.

    Raises:
        BagError: The images of the given topic are not aligned with the depth images.
    """
    images = [topic for topic in bag.topics_of(IMAGE) if topic != topics.depth]
    if given is None:
        return next((topic for topic in images if _misfit(bag, topic, contents) is None), None)
    if given not in images:
        raise BagError(
            f"there is no topic {shown(given)} of other images than depth; --intensity-topic may be: {listed(images)}"
        )
    if misfit := _misfit(bag, given, contents):
        raise BagError(
            f"{shown(given)} is not aligned with the depth images: {misfit}; name another topic by --intensity-topic, "
            "or omit it"
        )
    return given


def mean_intensities(
    bag: Bag, topic: str, poses: tuple[StationaryPose, ...], stamps_ns: NDArray[np.int64], shape: tuple[int, int]
) -> dict[int, NDArray[np.uint8]]:
    """Return the mean of the images of each view, by the number of the view. A view without images is left out.

    Args:
        bag: The bag.
        topic: Topic of the intensity images.
        poses: Positions at which the arm stood still.
        stamps_ns: Stamps of all depth images, nanoseconds.
        shape: Height and width of the depth images.

    Raises:
        BagError: An image has another size or encoding.
    """
    starts_ns = np.array([stamps_ns[pose.frames[0]] for pose in poses]) - SLACK_NS
    ends_ns = np.array([stamps_ns[pose.frames[-1]] for pose in poses]) + SLACK_NS
    sums: dict[int, NDArray[np.uint16]] = {}
    counts: dict[int, int] = {}
    for _, image in bag.messages([topic]):
        stamp_ns = nanoseconds(image.header.stamp)
        views = np.flatnonzero((starts_ns <= stamp_ns) & (stamp_ns <= ends_ns)).tolist()
        if len(views) == 0 or counts.get(views[0], 0) == MAX_IMAGES:
            continue
        view = views[0]
        grey = _grey_levels(image, shape, f"{shown(topic)}, image of {stamp_ns} ns")
        sums[view] = sums.get(view, np.zeros(shape, dtype=np.uint16)) + grey
        counts[view] = counts.get(view, 0) + 1
    return {view: np.rint(total / counts[view]).astype(np.uint8) for view, total in sums.items()}


def _misfit(bag: Bag, topic: str, contents: Survey) -> str | None:
    """Return why the images of a topic are not aligned with the depth images, or None if they are."""
    _, image = next(bag.messages([topic]))
    info_topic = f"{topic.rsplit('/', 1)[0]}/camera_info"
    if image.encoding not in ENCODINGS:
        return f"its images are {shown(image.encoding)!r}, not mono8"
    if info_topic not in bag.topics_of(CAMERA_INFO):
        return f"there is no {shown(info_topic)}"
    _, info = next(bag.messages([info_topic]))
    depth = contents.intrinsics
    try:
        own = intrinsics_of(info, is_rectified(topic), shown(info_topic))
        if len({(size.width, size.height) for size in (image, own, depth)}) > 1:
            return f"it is of {image.width}x{image.height} pixels, the depth of {depth.width}x{depth.height}"
        if np.abs(own.K - depth.K).max() > SAME_K_PX:
            return "its camera matrix is another one"
        return _apart(frame_name(image.header.frame_id), contents)
    except BagError as error:
        return str(error)


def _apart(frame: str, contents: Survey) -> str | None:
    """Return that the cameras of two frames are apart, or None if they are the same."""
    if frame == contents.camera_frame:
        return None
    poses, _ = contents.tree.chain(contents.camera_frame, frame).at(contents.stamps_ns[:1])
    distance_m = float(np.linalg.norm(poses.translation[0]))
    angle_rad = float(poses.rotation[0].magnitude())
    if distance_m <= SAME_CAMERA_M and angle_rad <= SAME_CAMERA_RAD:
        return None
    return f"its frame {shown(frame)!r} is {distance_m * 1000:.1f} mm from {shown(contents.camera_frame)!r}"


def _grey_levels(image: Any, shape: tuple[int, int], where: str) -> NDArray[np.uint8]:
    """Return the grey levels (H, W) of a sensor_msgs/Image after a check of its size."""
    height, width, step = int(image.height), int(image.width), int(image.step)
    if image.encoding not in ENCODINGS or (height, width) != shape or not width <= step <= len(image.data) / height:
        raise BagError(
            f"{where}: an image of {width}x{height} pixels, {step} bytes a row, of {shown(image.encoding)!r} has "
            f"{len(image.data)} bytes; mono8 of {shape[1]}x{shape[0]} pixels is needed"
        )
    rows = np.frombuffer(image.data, dtype=np.uint8)[: height * step].reshape(height, step)
    return rows[:, :width]
