"""The simulated camera as a node of a host-only depthai pipeline."""

import logging
import threading
import time
from collections.abc import Callable
from datetime import timedelta

import numpy as np
from numpy.typing import NDArray

from cell.devices import CameraInfo
from cell.errors import CameraLostError, CameraUnreachableError
from cell.oak_stream import Fault, Stream, load, next_message
from cell.settings import SimulatedCamera
from cell.simulation.flange import PoseSource
from cell.simulation.frames import FrameSource
from cell.simulation.world import SimulatedWorld

log = logging.getLogger(__name__)

EXPOSURE_US = 4000
"""To which the automatic exposure settles."""
IDLE_TICKS = 5
"""While nobody waits for images only every so many are taken: the others would be thrown away unseen."""
STALE_S = 3600.0


class Lens:
    """What the node takes images of and when; lives on this side of depthai, so that it can be told things."""

    def __init__(self, frames: FrameSource, pose: PoseSource, fps: float) -> None:
        self._frames, self._pose, self._period_s = frames, pose, 1 / fps
        self._change = threading.Condition()
        self._wanted, self._ended = False, False
        self._fault: Fault = "none"
        self._due_s = time.monotonic()
        self.trouble: str | None = None
        """Why it cannot go on, if it cannot."""

    def want(self, wanted: bool) -> None:
        """Whether somebody waits for images; if nobody does, it takes fewer."""
        with self._change:
            self._wanted = wanted
            self._change.notify()

    def fail(self, kind: Fault) -> None:
        """Fails from now on."""
        self._fault = kind
        if kind == "lost":
            self.end()

    def end(self) -> None:
        """No further images."""
        with self._change:
            self._ended = True
            self._change.notify()

    def next_image(self) -> tuple[float, NDArray[np.uint16]] | None:
        """Waits for the next image; gives when its exposure began, and the depth (H, W). None: there is no next."""
        while self._wait():
            began_s = time.monotonic()
            depth = self._frames.expose(self._pose())
            if self._fault == "zero":
                depth = np.zeros_like(depth)
            elif self._fault == "constant":
                depth = np.full_like(depth, 5000)
            elif self._fault == "stale":
                began_s -= STALE_S
            if self._fault != "silent":
                return began_s, depth
        return None

    def _wait(self) -> bool:
        """Until the next image is due; false: there is no next. Images are due at even times, or are left out."""
        with self._change:
            ticks = 0
            while not self._ended:
                late_s = time.monotonic() - self._due_s
                if late_s < 0:
                    self._change.wait(-late_s)
                    continue
                self._due_s += self._period_s * (late_s // self._period_s + 1)
                ticks += 1
                if self._wanted or ticks >= IDLE_TICKS:
                    return True
        return False


def open_simulated(settings: SimulatedCamera, world: SimulatedWorld, make_pose: Callable[[], PoseSource]) -> Stream:
    """A running pipeline whose images show `world` from where the flange is.

    Raises:
        CameraUnreachableError: nobody tells where the flange is.
    """
    load()
    import depthai as dai

    try:
        pose = make_pose()
        pose()
    except (OSError, ValueError, EOFError) as error:
        raise CameraUnreachableError(
            f"the simulated camera cannot learn from the simulated arm's controller where it is: {error}"
        ) from error
    model = world.camera
    lens = Lens(FrameSource(world), pose, settings.fps)
    # What is told of a camera beside its own matrix: it is the left one, and the reference.
    place = dai.Extrinsics(np.eye(4).tolist(), dai.CameraBoardSocket.CAM_B)
    view = dai.ImgTransformation(
        model.width, model.height, model.K.tolist(), dai.CameraModel.Perspective, [0.0] * 14, place
    )

    closed: type[Exception] = dai.MessageQueue.QueueException

    class SimulatedOak(dai.node.ThreadedHostNode):
        """Sends depth images as a camera does. Its exposure time runs up to a steady one until it is locked."""

        def __init__(self) -> None:
            super().__init__()
            self.depth = self.createOutput()
            self.control = self.createInput()

        def run(self) -> None:
            try:
                self._run()
            except (closed, CameraLostError):  # it is being closed
                return
            except OSError as error:
                lens.trouble = f"the simulated camera no longer learns where the arm is: {error}"
            except Exception as error:  # depthai ends the whole process for one that gets out
                log.exception("the simulated camera ended")
                lens.trouble = f"the simulated camera ended: {type(error).__name__}: {error}"

        def _run(self) -> None:
            exposure_us, number, locked = EXPOSURE_US / 8, 0, False
            while self.isRunning() and (image := lens.next_image()) is not None:
                while not locked and (control := next_message(self.control, 0.0)) is not None:
                    locked = control.getCommand(dai.CameraControl.Command.AE_LOCK)
                exposure_us = exposure_us if locked else min(exposure_us * 2, EXPOSURE_US)
                began_s, depth = image
                message = dai.ImgFrame()
                message.setType(dai.ImgFrame.Type.RAW16)
                message.setWidth(model.width)
                message.setHeight(model.height)
                message.setStride(2 * model.width)
                message.setData(depth.astype("<u2").tobytes())
                message.setTransformation(view)
                message.setInstanceNum(int(dai.CameraBoardSocket.CAM_B.value))
                message.setSequenceNum(number)
                message.cam.exposureTimeUs = int(exposure_us)
                # A camera stamps the end of the exposure.
                message.setTimestamp(timedelta(seconds=began_s, microseconds=int(exposure_us)))
                self.depth.send(message)
                number += 1

    pipeline = dai.Pipeline(False)
    node = pipeline.create(SimulatedOak)
    depth = node.depth.createOutputQueue(maxSize=1, blocking=False)
    controls = [node.control.createInputQueue()]
    info = CameraInfo(
        product=f"simulated {model.name}",
        device_id=world.camera_id,
        width=model.width,
        height=model.height,
        connection="simulated",
        temperature_c=None,
        warnings=(),
    )

    def close() -> None:
        lens.end()
        pipeline.stop()
        pipeline.wait()  # else the thread of the node meets the end of what it sends to

    pipeline.start()
    return Stream(pipeline, depth, depth, controls, lambda: info, close, lens)
