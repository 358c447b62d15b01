"""Depth images out of a running depthai pipeline, be it on a camera or on this machine."""

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import timedelta
from typing import TYPE_CHECKING, Any, Literal, Protocol

import numpy as np

from cell.devices import CameraInfo
from cell.errors import BadFrameError, CameraLostError
from cell.exposures import Exposure

if TYPE_CHECKING:
    import depthai as dai

DEPTH_UNIT_M = 0.0001
"""Metres per depth count, of every camera here: set on a real one."""

LONGEST_EXPOSURE_S = 0.033
"""Taken for the exposure time of a depth image that does not tell it."""

LEAST_WAIT_S = 0.001
"""The shortest time that a queue can be told to wait."""

Fault = Literal["none", "silent", "zero", "constant", "stale", "lost"]
"""What a simulated camera can be told to do wrong: send nothing, send images without or of one depth, send images of
long ago, close its stream."""


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
    rehearsal: Rehearsal | None = None
    """None for a real camera."""

    def watch(self, watched: bool) -> None:
        """Somebody waits for images, or no longer does."""
        if self.rehearsal is not None:
            self.rehearsal.want(watched)

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


def send(queue: "dai.InputQueue", setting: "dai.CameraControl") -> None:
    """Tells an image sensor a setting. Raises CameraLostError."""
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

    width, height, stride = message.getWidth(), message.getHeight(), message.getStride()
    data = np.asarray(message.getData(), dtype=np.uint8)
    fits = 0 < 2 * width <= stride and 0 < height * stride <= data.size
    if message.getType() != dai.ImgFrame.Type.RAW16 or not fits:
        raise BadFrameError(
            f"the camera sent {data.size} bytes of type {message.getType().name}, {width}x{height}, stride {stride}: "
            "that is no depth image"
        )
    rows = np.ascontiguousarray(data[: height * stride].reshape(height, stride)[:, : 2 * width])
    K = np.array(message.getTransformation().getIntrinsicMatrix(), dtype=np.float64)
    began_s = message.getTimestamp(dai.CameraExposureOffset.START).total_seconds()
    if message.getExposureTime() <= timedelta(0):
        began_s -= LONGEST_EXPOSURE_S
    return Exposure(rows.view("<u2").astype(np.uint16), K, began_s)
