"""Conversion of views to Foxglove messages and back. Every value of a message is checked before it is used."""

import io
import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.Quaternion_pb2 import Quaternion
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from foxglove_schemas_protobuf.Vector3_pb2 import Vector3
from google.protobuf.message import DecodeError
from google.protobuf.timestamp_pb2 import Timestamp
from numpy.typing import NDArray

from calibration.geometry.transforms import NotRigidError, from_quaternion, to_quaternion
from cell.devices import View
from cell.recording.errors import RecordingContentError, RecordingTooLargeError, shown

POSE, CALIBRATION, DEPTH, COLOUR = "/tf", "/camera/calibration", "/camera/depth", "/camera/color"
INTENSITY = "/camera/intensity"
SCHEMAS = {
    POSE: FrameTransform,
    CALIBRATION: CameraCalibration,
    INTENSITY: RawImage,
    DEPTH: RawImage,
    COLOUR: CompressedImage,
}
"""Message type of each topic of a view."""

BASE, FLANGE, CAMERA = "base", "flange", "camera"
"""Frame names in a recording."""

DEPTH_ENCODINGS = ("16UC1", "mono16")
"""Encodings of a depth image that are read. The first one is written."""
INTENSITY_ENCODINGS = ("mono8", "8UC1")
"""Encodings of an intensity image that are read. The first one is written."""
REACH_M = 100.0
"""Largest distance of a flange from its base."""
FOCAL_MAX = 1e6
"""Largest focal length of a depth camera, pixels."""


class UnusableColourError(ValueError):
    """A colour image cannot be used. Its view is complete without it."""


@dataclass(frozen=True, eq=False)
class PinholeCalibration:
    """Pinhole calibration of images of one size."""

    K: NDArray[np.float64]
    """(3, 3) pinhole matrix, pixels."""
    width: int
    """Width of the image, pixels."""
    height: int
    """Height of the image, pixels."""


def encode_view(view: View, log_time_ns: int) -> list[tuple[str, Any]]:
    """Return the messages of a view with their topics. Depth and intensity image are stored without loss."""
    stamp = Timestamp()
    stamp.FromNanoseconds(log_time_ns)
    height, width = view.depth.shape
    x, y, z = (float(value) for value in view.T_base_flange[:3, 3])
    qx, qy, qz, qw = (float(value) for value in to_quaternion(view.T_base_flange))
    pose = FrameTransform(
        timestamp=stamp,
        parent_frame_id=BASE,
        child_frame_id=FLANGE,
        translation=Vector3(x=x, y=y, z=z),
        rotation=Quaternion(x=qx, y=qy, z=qz, w=qw),
    )
    calibration = CameraCalibration(
        timestamp=stamp,
        frame_id=CAMERA,
        width=width,
        height=height,
        distortion_model="plumb_bob",
        D=[0.0] * 5,
        K=view.K.ravel().tolist(),
        R=np.eye(3).ravel().tolist(),
        P=np.column_stack([view.K, np.zeros(3)]).ravel().tolist(),
    )
    depth = RawImage(
        timestamp=stamp,
        frame_id=CAMERA,
        width=width,
        height=height,
        encoding=DEPTH_ENCODINGS[0],
        step=2 * width,
        data=view.depth.astype("<u2").tobytes(),
    )
    messages: list[tuple[str, Any]] = [(POSE, pose), (CALIBRATION, calibration)]
    if view.intensity is not None:
        intensity = RawImage(
            timestamp=stamp,
            frame_id=CAMERA,
            width=width,
            height=height,
            encoding=INTENSITY_ENCODINGS[0],
            step=width,
            data=view.intensity.tobytes(),
        )
        # before the depth, so that a view of a file that is cut off has its intensity image when it is complete
        messages.append((INTENSITY, intensity))
    messages.append((DEPTH, depth))
    if view.colour_jpeg is not None:
        colour = CompressedImage(timestamp=stamp, frame_id=CAMERA, format="jpeg", data=view.colour_jpeg)
        messages.append((COLOUR, colour))
    return messages


def decode_pose(data: bytes, where: str) -> NDArray[np.float64] | None:
    """Return T_base_flange (4, 4) of a foxglove.FrameTransform, or None for other frames."""
    message = _decode(FrameTransform(), data, f"{where}: {POSE}")
    if (message.parent_frame_id, message.child_frame_id) != (BASE, FLANGE):
        return None
    t, q = message.translation, message.rotation
    try:
        # the norm of a very long quaternion overflows to infinity, which is rejected too
        with np.errstate(over="ignore"):
            T = from_quaternion((t.x, t.y, t.z), (q.x, q.y, q.z, q.w), f"{where}: T_base_flange")
    except NotRigidError as error:
        raise RecordingContentError(str(error)) from error
    if np.abs(T[:3, 3]).max() > REACH_M:
        raise RecordingContentError(f"{where}: T_base_flange is at {T[:3, 3].tolist()} m; translations are metres")
    return T


def decode_calibration(data: bytes, where: str) -> PinholeCalibration:
    """Return K and image size of a foxglove.CameraCalibration, which must be a pinhole camera without distortion."""
    message = _decode(CameraCalibration(), data, f"{where}: {CALIBRATION}")
    if len(message.K) != 9:
        raise RecordingContentError(f"{where}: {CALIBRATION} has {len(message.K)} values of K; 9 are needed")
    K = np.array(message.K, dtype=np.float64).reshape(3, 3)
    if not np.isfinite(K).all():
        raise RecordingContentError(f"{where}: K holds NaN or infinity: {K.tolist()}")
    if np.any(np.asarray(message.D, dtype=np.float64) != 0):
        raise RecordingContentError(
            f"{where}: {CALIBRATION} has distortion {list(message.D[:8])}; "
            "record rectified depth images, which have none"
        )
    if K[0, 1] != 0 or K[1, 0] != 0 or not np.array_equal(K[2], (0, 0, 1)):
        raise RecordingContentError(f"{where}: K is {K.tolist()}; [[fx, 0, cx], [0, fy, cy], [0, 0, 1]] is needed")
    if not (1 <= K[0, 0] <= FOCAL_MAX and 1 <= K[1, 1] <= FOCAL_MAX):
        raise RecordingContentError(f"{where}: K has focal lengths {K[0, 0]:g}, {K[1, 1]:g} pixels; not a camera's")
    return PinholeCalibration(K, message.width, message.height)


def decode_depth(data: bytes, where: str, max_pixels: int) -> NDArray[np.uint16]:
    """Return the depth image (H, W) of a foxglove.RawImage with 16-bit counts, little-endian as Foxglove defines."""
    message = _decode(RawImage(), data, f"{where}: {DEPTH}")
    rows = _rows(message, DEPTH_ENCODINGS, 2, max_pixels, f"{where}: the depth image")
    return rows.view("<u2").astype(np.uint16)


def decode_intensity(data: bytes, where: str, max_pixels: int) -> NDArray[np.uint8]:
    """Return the intensity image (H, W) of a foxglove.RawImage with 8-bit grey levels."""
    message = _decode(RawImage(), data, f"{where}: {INTENSITY}")
    # a copy, which does not keep the message in memory
    return _rows(message, INTENSITY_ENCODINGS, 1, max_pixels, f"{where}: the intensity image").copy()


def _rows(
    message: RawImage, encodings: tuple[str, ...], pixel_bytes: int, max_pixels: int, what: str
) -> NDArray[np.uint8]:
    """Return the rows of an image (H, W * pixel_bytes) without padding."""
    height = message.height
    width = message.width
    step = message.step
    if message.encoding not in encodings:
        raise RecordingContentError(f"{what} has encoding {message.encoding[:40]!r}; only {encodings[0]} is read")
    if height * width == 0:
        raise RecordingContentError(f"{what} is empty ({width}x{height})")
    if height * width > max_pixels:
        raise RecordingTooLargeError(f"{what} announces {width}x{height} pixels; {max_pixels} at most are read")
    row_bytes = pixel_bytes * width
    if step < row_bytes or step * height != len(message.data):
        raise RecordingContentError(
            f"{what} of {width}x{height} pixels, {step} bytes a row, is {len(message.data)} bytes"
        )
    rows = np.frombuffer(message.data, dtype=np.uint8).reshape(height, step)[:, :row_bytes]
    return np.ascontiguousarray(rows)


def decode_colour(data: bytes, max_pixels: int) -> bytes:
    """Return the JPEG of a foxglove.CompressedImage.

    Raises:
        UnusableColourError: It cannot be used. The message says why; the subject is the image.
    """
    from PIL import Image, UnidentifiedImageError  # only for recordings with colour images

    message = CompressedImage()
    try:
        message.ParseFromString(data)
    except DecodeError as error:
        raise UnusableColourError(f"is not a {message.DESCRIPTOR.full_name}: {error}") from error
    if message.format.lower() not in ("jpeg", "jpg"):
        raise UnusableColourError(f"has the format {shown(message.format)!r}; only jpeg is supported")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", Image.DecompressionBombWarning)
            image = Image.open(io.BytesIO(message.data), formats=["JPEG"])
        if image.width * image.height > max_pixels:
            raise UnusableColourError(f"has {image.width}x{image.height} pixels; {max_pixels} at most are read")
        image.draft("L", (1, 1))  # an eighth of the size, which is faster; still all data is read
        image.load()
    except UnidentifiedImageError as error:
        raise UnusableColourError("is no JPEG, though it has that format") from error
    except (Image.DecompressionBombWarning, Image.DecompressionBombError) as error:
        raise UnusableColourError(f"has too many pixels; {max_pixels} at most are read") from error
    except (OSError, SyntaxError) as error:  # Pillow raises SyntaxError for a damaged file
        raise UnusableColourError(f"is a damaged JPEG: {error}") from error
    return message.data


def _decode(message: Any, data: bytes, where: str) -> Any:
    try:
        message.ParseFromString(data)
    except DecodeError as error:
        raise RecordingContentError(f"{where} is not a {message.DESCRIPTOR.full_name}: {error}") from error
    return message
