"""Depth images and pictures out of a running depthai pipeline, be it on a camera or on this machine."""

import os
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import timedelta
from typing import TYPE_CHECKING, Any, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from cell.camera.frame_averaging import Exposure, Picture
from cell.devices import CameraInfo
from cell.errors import BadFrameError, CameraLostError

if TYPE_CHECKING:
    import depthai as dai

DEPTH_UNIT_M = 0.0001
"""Metres per depth count, of every camera here: set on a real one."""

LONGEST_EXPOSURE_S = 0.033
"""Taken for the exposure time of a depth image that does not tell it."""

LEAST_WAIT_S = 0.001
"""The shortest time that a queue can be told to wait."""

DOTS_S = 0.1
"""So long after the dot projector is switched, exposures are surely begun with the new light."""

Fault = Literal["none", "silent", "zero", "constant", "stale", "lost"]
"""What a simulated camera can be told to do wrong: send nothing, send images without or of one depth and pictures that
are black or of one grey, send images of long ago, close its stream."""


class Rehearsal(Protocol):
    """What only a simulated camera can do."""

    @property
    def trouble(self) -> str | None:
        """Why it cannot go on, if it cannot."""
        ...

    def want(self, wanted: bool) -> None:
        """Whether somebody waits for images; if nobody does, it takes fewer."""
        ...

    def fail(self, kind: Fault) -> None:
        """Fails from now on."""
        ...


@dataclass(frozen=True, eq=False)
class Stream:
    """A running pipeline."""

    pipeline: "dai.Pipeline"
    depth: "dai.MessageQueue"
    timing: "dai.MessageQueue"
    """Images that tell the exposure time; may be the depth images."""
    controls: Sequence["dai.InputQueue"]
    """Take the settings of the image sensors."""
    describe: Callable[[], CameraInfo]
    """The camera now. Raises RuntimeError."""
    close: Callable[[], None]
    pictures: "dai.MessageQueue"
    """What the depth images' camera sees, rectified; only while the gate is open."""
    gate: "dai.InputQueue"
    """Takes `dai.GateControl`: whether pictures are sent. They are half as much again as the depth images."""
    dots: Callable[[bool], None] | None = None
    """Switches the dot projector, where one is used. Raises RuntimeError."""
    rehearsal: Rehearsal | None = None
    """None for a real camera."""

    def watch(self, watched: bool) -> None:
        """Somebody waits for images, or no longer does."""
        if self.rehearsal is not None:
            self.rehearsal.want(watched)

    @contextmanager
    def sending_pictures(self) -> Iterator[None]:
        """Within, pictures come. Raises CameraLostError."""
        import depthai as dai

        send(self.gate, dai.GateControl.openGate())
        try:
            yield
        finally:
            send(self.gate, dai.GateControl.closeGate())

    @contextmanager
    def without_dots(self) -> Iterator[None]:
        """Within, exposures that begin now are not lit by dots, and those after it are again. Raises CameraLostError.

        Dots on a board look like corners and shift those that are there; depth is better with them.
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
    def trouble(self) -> str | None:
        """Why there are no images, where that is known."""
        return None if self.rehearsal is None else self.rehearsal.trouble


def load(device: str | None = None) -> None:
    """Imports depthai, quietly: it reads these variables when it is imported, and never again.

    `device` is the configured one; without it cameras are looked for on USB only, not by broadcast in the network.
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
    """The next message, or None if none comes in so many seconds. Raises CameraLostError.

    Always by a `get` that waits, a millisecond at least: depthai's `tryGet` and `isClosed` keep Python waiting for the
    queue, while a thread that fills the queue may be waiting for Python: both for ever.
    """
    with _link():
        return queue.get(timedelta(seconds=max(wait_s, LEAST_WAIT_S)))


def send(queue: "dai.InputQueue", setting: "dai.CameraControl | dai.GateControl") -> None:
    """Tells an image sensor, or a gate, a setting. Raises CameraLostError."""
    with _link():
        queue.send(setting)


@contextmanager
def _link() -> Iterator[None]:
    """What a broken link makes of the use of a queue is a lost camera."""
    import depthai as dai

    # Of a queue that was closed, and of a link that broke: depthai's XLinkErrors are RuntimeErrors.
    closed: type[Exception] = dai.MessageQueue.QueueException
    try:
        yield
    except (closed, RuntimeError) as error:
        raise CameraLostError(
            f"the link to the camera broke: check its cable and power supply ({str(error).strip()})"
        ) from error


def decode(message: "dai.ImgFrame") -> Exposure:
    """The exposure in a message.

    Raises:
        BadFrameError: it is no depth image.
    """
    import depthai as dai

    rows = _rows(message, 2, "depth image", message.getType() == dai.ImgFrame.Type.RAW16)
    return Exposure(rows.view("<u2").astype(np.uint16), _K(message), _began_s(message))


def decode_picture(message: "dai.ImgFrame") -> Picture:
    """The picture in a message: grey as it is; of a luma and colour image the luma; blue, green, red interleaved.

    Raises:
        BadFrameError: it is no picture, or of a kind that no camera here is set to send.
    """
    import depthai as dai

    kind, known = message.getType(), dai.ImgFrame.Type
    # Of these the first H rows are the grey image.
    luma = (known.GRAY8, known.RAW8, known.YUV400p, known.NV12, known.NV21, known.YUV420p)
    depth = 3 if kind == known.BGR888i else 1
    rows = _rows(message, depth, "picture", kind == known.BGR888i or kind in luma)
    pixels = rows.reshape(len(rows), -1, 3) if depth == 3 else rows
    return Picture(pixels, _K(message), _began_s(message))


def _rows(message: "dai.ImgFrame", pixel_bytes: int, what: str, of_its_kind: bool) -> NDArray[np.uint8]:
    """The image's rows (H, W * pixel_bytes), without their padding."""
    width, height, stride = message.getWidth(), message.getHeight(), message.getStride()
    data = np.asarray(message.getData(), dtype=np.uint8)
    row_bytes = pixel_bytes * width
    if not (of_its_kind and 0 < row_bytes <= stride and 0 < height * stride <= data.size):
        raise BadFrameError(
            f"the camera sent {data.size} bytes of type {message.getType().name}, {width}x{height}, stride {stride}: "
            f"that is no {what}"
        )
    # A copy: depthai takes its memory back.
    return data[: height * stride].reshape(height, stride)[:, :row_bytes].copy()


def _K(message: "dai.ImgFrame") -> NDArray[np.float64]:
    return np.array(message.getTransformation().getIntrinsicMatrix(), dtype=np.float64)


def _began_s(message: "dai.ImgFrame") -> float:
    """When the exposure began, seconds of `time.monotonic()`."""
    import depthai as dai

    began_s = message.getTimestamp(dai.CameraExposureOffset.START).total_seconds()
    return began_s if message.getExposureTime() > timedelta(0) else began_s - LONGEST_EXPOSURE_S
