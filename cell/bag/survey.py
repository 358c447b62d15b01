"""Survey of a bag: the topics to read, then all messages without the pixels."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cell.bag.bag_file import CAMERA_INFO, COMPRESSED_IMAGE, IMAGE, TRANSFORMS, Bag
from cell.bag.depth_image import DEPTH_ONLY_ENCODINGS, Intrinsics, intrinsics_of
from cell.bag.errors import BagError, listed
from cell.bag.tf_tree import TransformTree, frame_name, nanoseconds
from cell.recording.errors import shown

STATIC = "tf_static"


@dataclass(frozen=True)
class Topics:
    """Topics of the depth images and of their CameraInfo."""

    depth: str
    info: str


@dataclass(frozen=True, eq=False)
class Survey:
    """Content of a bag without the pixels."""

    tree: TransformTree
    intrinsics: Intrinsics
    stamps_ns: NDArray[np.int64]
    """Stamps (N,) of the depth images, increasing, nanoseconds."""
    camera_frame: str
    """Frame of the depth images, by their headers."""
    encoding: str


def find_topics(bag: Bag, depth: str | None, info: str | None) -> Topics:
    """Return the given topics, or the only ones of their kind.

    Of several CameraInfos, the one beside the images is taken.

    Args:
        bag: The bag.
        depth: Topic of the depth images, or None.
        info: Topic of the CameraInfo, or None.

    Raises:
        BagError: A given topic is missing, or it is unclear which one is meant.
    """
    if depth is None:
        depth = _only_depth(bag)
    elif bag.topics.get(depth) != IMAGE:
        raise _no_such(bag, depth, IMAGE, "--depth-topic")
    if info is None:
        infos = bag.topics_of(CAMERA_INFO)
        beside = f"{depth.rsplit('/', 1)[0]}/camera_info"
        if beside not in infos and len(infos) != 1:
            raise BagError(
                f"it is not clear which CameraInfo belongs to {shown(depth)}: there is no {shown(beside)}; name one of "
                f"these by --info-topic: {listed(infos)}"
            )
        info = beside if beside in infos else infos[0]
    elif bag.topics.get(info) != CAMERA_INFO:
        raise _no_such(bag, info, CAMERA_INFO, "--info-topic")
    return Topics(depth, info)


def survey(bag: Bag, topics: Topics, rectified: bool) -> Survey:
    """Read the transforms, the camera matrix and the headers of the images.

    Args:
        bag: The bag.
        topics: Topics to read.
        rectified: Whether the images are rectified.

    Raises:
        BagError: There are no images, the camera matrix cannot be used, or a constant value changes.
    """
    tree, lenses, stamps_ns = TransformTree(), [], []
    heads: set[tuple[str, str, int, int]] = set()
    transforms = bag.topics_of(*TRANSFORMS)
    if not transforms:
        raise BagError(
            f"the bag has no transforms (/tf): record them with the images; its topics: {listed(bag.topics)}"
        )
    for topic, message in bag.messages({topics.depth, topics.info, *transforms}):
        if topic in transforms:
            tree.add(message, topic.endswith(STATIC))
        elif topic == topics.info:
            intrinsics = intrinsics_of(message, rectified, shown(topic))
            if not any(_same_intrinsics(intrinsics, known) for known in lenses):
                lenses.append(intrinsics)
        else:
            stamps_ns.append(nanoseconds(message.header.stamp))
            heads.add((frame_name(message.header.frame_id), message.encoding, message.width, message.height))
        if len(lenses) > 1 or len(heads) > 1:
            what, where = ("lens", topics.info) if len(lenses) > 1 else ("frame, encoding or size", topics.depth)
            raise BagError(f"{shown(where)}: the {what} changes within the bag; cut the bag there")
    if not lenses or not heads:
        raise BagError(f"the bag has no messages on {shown(topics.depth)} or {shown(topics.info)}")
    ((frame, encoding, width, height),) = heads
    (intrinsics,) = lenses
    if (intrinsics.width, intrinsics.height) != (width, height):
        size = f"{intrinsics.width}x{intrinsics.height}"
        raise BagError(
            f"{shown(topics.info)} is of {size} pixels, the images on {shown(topics.depth)} are {width}x{height}: "
            "name the CameraInfo that belongs to them by --info-topic"
        )
    if intrinsics.frame not in ("", frame):
        raise BagError(
            f"{shown(topics.info)} is of the frame {shown(intrinsics.frame)!r}, the images on {shown(topics.depth)} of "
            f"{shown(frame)!r}: name the CameraInfo that belongs to them by --info-topic"
        )
    if min(stamps_ns) <= 0:
        raise BagError(
            f"{shown(topics.depth)}: images have no stamp (0), so that /tf cannot tell where they were taken"
        )
    return Survey(tree, intrinsics, np.unique(np.array(stamps_ns, dtype=np.int64)), frame, encoding)


def _only_depth(bag: Bag) -> str:
    """Return the only topic whose first image is a depth image. Raise BagError otherwise."""
    images = bag.topics_of(IMAGE)
    found = [topic for topic in images if _first_encoding(bag, topic) in DEPTH_ONLY_ENCODINGS]
    if len(found) == 1:
        return found[0]
    if found:
        raise BagError(
            f"there are {len(found)} topics of depth images; name one of them by --depth-topic: {listed(found)}"
        )
    compressed = [topic for topic in bag.topics_of(COMPRESSED_IMAGE) if "depth" in topic.lower()]
    if compressed:
        raise BagError(
            f"the depth images are compressed ({listed(compressed)}), which is not supported: decompress them by "
            "`image_transport republish compressedDepth raw`, and record again"
        )
    raise BagError(f"there is no topic of depth images (16UC1 or 32FC1); of other images: {listed(images)}")


def _first_encoding(bag: Bag, topic: str) -> str:
    return next((str(message.encoding) for _, message in bag.messages([topic])), "")


def _no_such(bag: Bag, topic: str, kind: str, option: str) -> BagError:
    name = kind.rsplit("/", 1)[-1]
    return BagError(f"there is no topic {shown(topic)} of type {name}; {option} may be: {listed(bag.topics_of(kind))}")


def _same_intrinsics(a: Intrinsics, b: Intrinsics) -> bool:
    return (a.width, a.height, a.frame) == (b.width, b.height, b.frame) and np.array_equal(a.K, b.K)
