"""Depth and intensity images of a running depthai pipeline, on a camera or on this machine."""

import os
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import timedelta
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from cell.camera.driver import Fault
from cell.camera.frame_averaging import Exposure, Picture
from cell.devices import CameraInfo
from cell.errors import BadFrameError, CameraLostError

if TYPE_CHECKING:
    import depthai as dai

DEPTH_UNIT_M = 0.0001
"""Metres per depth count of a real camera, which is set to it, and of most simulated ones."""

LONGEST_EXPOSURE_S = 0.033
"""Exposure time that is assumed for a depth image without one."""

MIN_WAIT_S = 0.001
"""Shortest timeout of a queue."""

SPARE_PICTURES = 8
"""Intensity images that a queue holds beside those of one capture, so that none is lost before its depth image is
read."""

DOTS_S = 0.1
"""Time after switching the dot projector until every new exposure has the new light."""


class FaultInjection(Protocol):
    """Control of a simulated camera."""

    @property
    def stop_reason(self) -> str | None:
        """Why the camera cannot continue, or None."""
        ...

    def set_waiting(self, waiting: bool) -> None:
        """Set whether images are awaited. Otherwise the camera renders fewer of them."""
        ...

    def fail(self, kind: Fault) -> None:
        """Fail from now on."""
        ...


@dataclass(frozen=True, eq=False)
class Stream:
    """A running pipeline with its queues."""

    pipeline: "dai.Pipeline"
    """Pipeline on the camera or on this machine."""
    depth: "dai.MessageQueue"
    """Depth images."""
    timing: "dai.MessageQueue"
    """Images with the exposure time. It may be the queue of the depth images."""
    controls: Sequence["dai.InputQueue"]
    """Queues for the settings of the image sensors."""
    describe: Callable[[], CameraInfo]
    """Describes the camera's present state. It raises RuntimeError."""
    close: Callable[[], None]
    """Ends the pipeline and releases the device."""
    pictures: "dai.MessageQueue"
    """Rectified intensity images of the camera that takes the depth images, while the gate is open."""
    gate: "dai.InputQueue"
    """Queue for `dai.GateControl`, which switches the intensity images. They have half the size of the depth images."""
    depth_unit_m: float = DEPTH_UNIT_M
    """Metres per depth count."""
    dots: Callable[[bool], None] | None = None
    """Switches the dot projector, or None without one. It raises RuntimeError."""
    fault_injection: FaultInjection | None = None
    """Control of a simulated camera, or None for a real one."""

    def watch(self, watched: bool) -> None:
        """Set whether images are awaited."""
        if self.fault_injection is not None:
            self.fault_injection.set_waiting(watched)

    @contextmanager
    def sending_pictures(self) -> Iterator[None]:
        """Send intensity images within the body of a `with` statement. Raise CameraLostError if the link broke."""
        import depthai as dai

        send(self.gate, dai.GateControl.openGate())
        try:
            yield
        finally:
            send(self.gate, dai.GateControl.closeGate())

    @contextmanager
    def without_dots(self) -> Iterator[None]:
        """Switch the dot projector off within the body of a `with` statement. Raise CameraLostError if the link broke.

        Dots improve the depth, but on a calibration board they look like corners and shift the real ones.
        """
        if self.dots is None:
            yield
            return
        self._switch_dots(False)
        try:
            yield
        finally:
            self._switch_dots(True)

    def _switch_dots(self, on: bool) -> None:
        if self.dots is not None:
            with _link():
                self.dots(on)
            time.sleep(DOTS_S)

    @property
    def stop_reason(self) -> str | None:
        """Why no images come, or None if that is not known."""
        return None if self.fault_injection is None else self.fault_injection.stop_reason


def load(device: str | None = None) -> None:
    """Import depthai without telemetry and log output. It reads these variables only when it is imported.

    Args:
        device: Configured device. None restricts the search for cameras to USB, without a broadcast in the network.
    """
    os.environ |= {
        "DEPTHAI_TELEMETRY": "0",
        "DEPTHAI_AUTOCALIBRATION": "OFF",  # it would rewrite the intrinsics that the hand-eye calibration rests on
        "DEPTHAI_INSTALL_SIGNAL_HANDLER": "0",  # a full disk's signal, which Python ignores, would end the process
        "DEPTHAI_SEARCH_TIMEOUT": "500",
        "DEPTHAI_PROTOCOL": "usb" if device is None else "any",
    }
    os.environ.setdefault("DEPTHAI_LEVEL", "off")  # what matters comes as an exception

    import depthai  # noqa: F401 (it reads the environment now)


def next_message(queue: "dai.MessageQueue", wait_s: float) -> Any:
    """Return the next message, or None if none comes within `wait_s` seconds. Raise CameraLostError if the link broke.

    The function always waits by `get`, for at least a millisecond. depthai's `tryGet` and `isClosed` hold Python's lock
    while they wait for the queue, and a thread that fills the queue may wait for that lock: a deadlock.
    """
    with _link():
        return queue.get(timedelta(seconds=max(wait_s, MIN_WAIT_S)))


def send(queue: "dai.InputQueue", setting: "dai.CameraControl | dai.GateControl") -> None:
    """Send a setting to an image sensor or a gate. Raise CameraLostError if the link broke."""
    with _link():
        queue.send(setting)


@contextmanager
def _link() -> Iterator[None]:
    """Turn the errors of a broken link into CameraLostError."""
    import depthai as dai

    # depthai's XLinkErrors are RuntimeErrors
    closed: type[Exception] = dai.MessageQueue.QueueException
    try:
        yield
    except (closed, RuntimeError) as error:
        raise CameraLostError(
            f"the link to the camera broke: check its cable and power supply ({str(error).strip()})"
        ) from error


def decode(message: "dai.ImgFrame") -> Exposure:
    """Return the depth image of a message.

    Raises:
        BadFrameError: The message is not a depth image.
    """
    import depthai as dai

    rows = _rows(message, 2, "depth image", message.getType() == dai.ImgFrame.Type.RAW16)
    return Exposure(rows.view("<u2").astype(np.uint16), _K(message), _began_s(message), message.getSequenceNum())


def decode_picture(message: "dai.ImgFrame") -> Picture:
    """Return the intensity image of a message.

    A grey image and an interleaved BGR image are returned as they are. Of an image with luma and chroma planes, the
    luma is returned.

    Raises:
        BadFrameError: The message is not an image, or has a type that no pipeline here sends.
    """
    import depthai as dai

    kind, known = message.getType(), dai.ImgFrame.Type
    # the first H rows of these types are the grey image
    luma = (known.GRAY8, known.RAW8, known.YUV400p, known.NV12, known.NV21, known.YUV420p)
    depth = 3 if kind == known.BGR888i else 1
    rows = _rows(message, depth, "picture", kind == known.BGR888i or kind in luma)
    pixels = rows.reshape(len(rows), -1, 3) if depth == 3 else rows
    return Picture(pixels, _K(message), _began_s(message), message.getSequenceNum())


def _rows(message: "dai.ImgFrame", pixel_bytes: int, what: str, of_its_kind: bool) -> NDArray[np.uint8]:
    """Return the rows of the image (H, W * pixel_bytes), without padding."""
    width, height, stride = message.getWidth(), message.getHeight(), message.getStride()
    data = np.asarray(message.getData(), dtype=np.uint8)
    row_bytes = pixel_bytes * width
    if not (of_its_kind and 0 < row_bytes <= stride and 0 < height * stride <= data.size):
        raise BadFrameError(
            f"the camera sent {data.size} bytes of type {message.getType().name}, {width}x{height}, stride {stride}, "
            f"which is not a {what}"
        )
    # a copy, because depthai reuses its memory
    return data[: height * stride].reshape(height, stride)[:, :row_bytes].copy()


def _K(message: "dai.ImgFrame") -> NDArray[np.float64]:
    return np.array(message.getTransformation().getIntrinsicMatrix(), dtype=np.float64)


def _began_s(message: "dai.ImgFrame") -> float:
    """Return the start of the exposure, seconds of `time.monotonic()`."""
    import depthai as dai

    began_s = message.getTimestamp(dai.CameraExposureOffset.START).total_seconds()
    return began_s if message.getExposureTime() > timedelta(0) else began_s - LONGEST_EXPOSURE_S
