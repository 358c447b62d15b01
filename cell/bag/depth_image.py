"""Depth images and lenses as ROS tells them, checked before they are used."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cell.bag.errors import BagError
from cell.recording.errors import shown
from cell.recording.limits import DEFAULT_LIMITS

COUNTS, METRES = ("16UC1", "mono16"), ("32FC1",)
ENCODINGS = (*COUNTS, *METRES)
SURELY_DEPTH = ("16UC1", "32FC1")
"""Infrared images are mono16 as well."""
MILLIMETRE_M = 0.001
"""Of 16UC1, as REP 118 has it."""
FINE_M = 0.0001
"""Counts that metres are rounded to: below every camera's noise, and 16 bits reach 6.5 m."""


@dataclass(frozen=True, eq=False)
class Lens:
    """What a CameraInfo tells of the images that it belongs to."""

    K: NDArray[np.float64]
    """(3, 3) pinhole matrix, pixels."""
    width: int
    height: int
    frame: str
    """Its optical frame; empty where it is not told."""


def depth_unit(encoding: str, told_m: float | None) -> float:
    """Metres per count of the recording: what was told, or what the encoding has."""
    if told_m is not None:
        return told_m
    return FINE_M if encoding in METRES else MILLIMETRE_M


def depth_counts(image: Any, unit_m: float, where: str) -> NDArray[np.uint16]:
    """Depth (H, W) in units of `unit_m` of a sensor_msgs/Image; 0 where it has none, or beyond 65535 units.

    Raises:
        BagError: another encoding, too large, or bytes that do not fit its size.
    """
    height, width, step = int(image.height), int(image.width), int(image.step)
    if image.encoding not in ENCODINGS:
        raise BagError(
            f"{where}: images are {shown(image.encoding)!r}; depth as 16UC1 or 32FC1 is read: name another topic"
        )
    if not 0 < height * width <= DEFAULT_LIMITS.image_pixels:
        raise BagError(f"{where}: an image of {width}x{height} pixels; {DEFAULT_LIMITS.image_pixels} at most are taken")
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


def lens_of(info: Any, rectified: bool, where: str) -> Lens:
    """The lens of a sensor_msgs/CameraInfo: P of a `rectified` image, where it is told, K of one without distortion.

    Raises:
        BagError: the images are distorted, or turned or shifted by rectification, or no camera's.
    """
    # ROS 1 has capitals, ROS 2 has not.
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
                "rectified, by the nearest pixel (image_proc, interpolation 0), and name that topic; or say "
                "--rectified if they are"
            )
        raise BagError(f"{where}: the images are rectified, but P, which tells their lens, is not told (0)")
    return Lens(K, int(info.width), int(info.height), str(info.header.frame_id).removeprefix("/"))


def is_rectified(topic: str) -> bool:
    """By the names that ROS's drivers give: image_rect, image_rect_raw."""
    return any(word.startswith("rect") for word in topic.rsplit("/", 1)[-1].split("_"))
