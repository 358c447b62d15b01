"""Depth images and camera matrices of ROS messages, checked before they are used."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cell.bag.errors import BagError
from cell.recording.errors import shown
from cell.recording.limits import DEFAULT_LIMITS

COUNTS, METRES = ("16UC1", "mono16"), ("32FC1",)
ENCODINGS = (*COUNTS, *METRES)
DEPTH_ONLY_ENCODINGS = ("16UC1", "32FC1")
"""Encodings of depth images only. Infrared images are mono16 as well."""
MILLIMETRE_M = 0.001
"""Unit of 16UC1 by REP 118."""
FINE_M = 0.0001
"""Unit to which metres are rounded. It is below the noise of every camera, and 16 bits reach 6.5 m."""


@dataclass(frozen=True, eq=False)
class Intrinsics:
    """Camera matrix and size of the images of a CameraInfo."""

    K: NDArray[np.float64]
    """(3, 3) pinhole matrix, pixels."""
    width: int
    height: int
    frame: str
    """Optical frame, or an empty text."""


def depth_unit(encoding: str, given_m: float | None) -> float:
    """Return the metres per count of the recording, which are the given ones or those of the encoding."""
    if given_m is not None:
        return given_m
    return FINE_M if encoding in METRES else MILLIMETRE_M


def depth_counts(image: Any, unit_m: float, where: str) -> NDArray[np.uint16]:
    """Return the depth image (H, W) of a sensor_msgs/Image in units of `unit_m`.

    A pixel without depth, or with one beyond 65535 units, is 0.

    Args:
        image: The message.
        unit_m: Metres per count.
        where: Position of the image, for messages.

    Raises:
        BagError: The encoding is another one, the image is too large, or its bytes do not fit its size.
    """
    height, width, step = int(image.height), int(image.width), int(image.step)
    if image.encoding not in ENCODINGS:
        raise BagError(
            f"{where}: images are {shown(image.encoding)!r}; only 16UC1 and 32FC1 are supported: name another topic"
        )
    if not 0 < height * width <= DEFAULT_LIMITS.image_pixels:
        raise BagError(
            f"{where}: an image of {width}x{height} pixels; at most {DEFAULT_LIMITS.image_pixels} are allowed"
        )
    kind = np.dtype(np.float32 if image.encoding in METRES else np.uint16).newbyteorder(
        ">" if image.is_bigendian else "<"
    )
    if step < width * kind.itemsize or step * height != len(image.data):
        raise BagError(
            f"{where}: an image of {width}x{height} pixels with {step} bytes a row has {len(image.data)} bytes"
        )
    rows = np.frombuffer(image.data, dtype=np.uint8).reshape(height, step)[:, : width * kind.itemsize]
    values = np.ascontiguousarray(rows).view(kind)
    if image.encoding in COUNTS:
        return values.astype(np.uint16)
    with np.errstate(invalid="ignore", over="ignore"):
        counts = np.rint(values.astype(np.float64) / unit_m)
        return np.where((counts >= 1) & (counts <= np.iinfo(np.uint16).max), counts, 0).astype(np.uint16)


def intrinsics_of(info: Any, rectified: bool, where: str) -> Intrinsics:
    """Return the camera matrix of a sensor_msgs/CameraInfo.

    It is P for a rectified image, if P is set, and K for an image without distortion.

    Args:
        info: The message.
        rectified: Whether the images are rectified.
        where: Position of the message, for messages.

    Raises:
        BagError: The images are distorted, or rotated or shifted by the rectification, or the matrix is not a camera's.
    """
    # the fields are upper case in ROS 1 and lower case in ROS 2
    D, K, R, P = (
        np.asarray(getattr(info, name, getattr(info, name.lower(), ())), dtype=np.float64).ravel() for name in "DKRP"
    )
    if K.size != 9 or P.size != 12 or R.size != 9:
        raise BagError(f"{where}: K, R and P have {K.size}, {R.size} and {P.size} values; 9, 9 and 12 are needed")
    K, R, P = K.reshape(3, 3), R.reshape(3, 3), P.reshape(3, 4)
    if rectified and P[0, 0] != 0:
        if np.any(R[~np.eye(3, dtype=bool)] != 0) or np.any(P[:, 3] != 0):
            raise BagError(
                f"{where}: rectification turned or shifted the camera (R is not the identity, or P has a baseline), so "
                "that its frame in /tf is not the image's: take the images of the left, or the unrectified camera"
            )
        K = P[:, :3]
    elif np.any(D != 0):
        if not rectified:
            raise BagError(
                f"{where}: the lens has distortion ({', '.join(f'{d:.3g}' for d in D[:5])}): have the images "
                "rectified, by the nearest pixel (image_proc, interpolation 0), and name that topic; or give "
                "--rectified if they are rectified already"
            )
        raise BagError(f"{where}: the images are rectified, but their camera matrix P is 0: name another --info-topic")
    return Intrinsics(K, int(info.width), int(info.height), str(info.header.frame_id).removeprefix("/"))


def is_rectified(topic: str) -> bool:
    """Return whether images are rectified by the names of ROS's drivers, image_rect and image_rect_raw."""
    return any(word.startswith("rect") for word in topic.rsplit("/", 1)[-1].split("_"))
