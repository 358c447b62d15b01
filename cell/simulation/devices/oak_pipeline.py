"""Run the simulated camera as a node of a depthai pipeline on this machine."""

import logging
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from datetime import timedelta
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cell.camera.driver import Fault
from cell.camera.oak_stream import SPARE_PICTURES, Stream, load, next_message
from cell.config.camera_config import SimulatedCamera
from cell.devices import CameraInfo
from cell.errors import CameraLostError, CameraUnreachableError
from cell.simulation.devices.flange_pose import PoseSource
from cell.simulation.devices.frame_source import FrameSource, import_open3d
from cell.simulation.devices.world import SimulatedWorld
from cell.simulation.rendering.image_cache import ImageCache

log = logging.getLogger(__name__)

EXPOSURE_US = 4000
"""Exposure time at which the simulated automatic exposure settles, microseconds."""
IDLE_PERIOD_S = 0.5
"""Time between two rendered images while no caller waits for them."""
STALE_S = 3600.0
"""Age of the images with the fault `stale`, seconds."""


@dataclass(frozen=True, eq=False)
class ExposureImages:
    """Images of one exposure."""

    began_s: float
    """Start of the exposure, seconds of `time.monotonic()`."""
    depth: NDArray[np.uint16]
    """Depth image (H, W) in depth units of the camera. 0 means not measured."""
    picture: NDArray[np.uint8] | None
    """Intensity image (H, W), grey levels, or None if none was requested."""


class SimulatedImager:
    """Images and frame times of the simulated camera, with fault injection.

    This class does not depend on depthai. It satisfies `cell.camera.oak_stream.FaultInjection`.
    """

    def __init__(self, frames: FrameSource, pose: PoseSource, fps: float) -> None:
        """Start the frame clock.

        Args:
            frames: Renders the images.
            pose: Returns the flange pose of each image.
            fps: Frame rate, hertz.
        """
        self._frames, self._pose, self._period_s = frames, pose, 1 / fps
        self._change = threading.Condition()
        self._waiting, self._ended = False, False
        self._dots_on = True
        self._fault: Fault = "none"
        self._due_s = time.monotonic()
        self.stop_reason: str | None = None
        """Message with the reason why the camera stopped, or None."""

    def set_waiting(self, waiting: bool) -> None:
        """Set whether a caller waits for images. If not, one image is rendered in `IDLE_PERIOD_S`."""
        with self._change:
            self._waiting = waiting
            self._change.notify()

    def switch_dots(self, on: bool) -> None:
        """Switch the dot projector on or off, for the images that begin from now on."""
        self._dots_on = on

    def fail(self, kind: Fault) -> None:
        """Inject a fault from now on. `none` ends the earlier fault, but a camera that was `lost` stays lost."""
        self._fault = kind
        if kind == "lost":
            self.end()

    def end(self) -> None:
        """Render no further images."""
        with self._change:
            self._ended = True
            self._change.notify()

    def take(self, began_s: float, pictured: bool) -> ExposureImages | None:
        """Render the next images.

        Args:
            began_s: Start of the exposure, seconds of `time.monotonic()`.
            pictured: Whether to render an intensity image too.

        Returns:
            The images, changed by the injected fault. The fault `silent` returns None. A camera with rendered images
            also returns None while no caller waits for them.

        Raises:
            OSError: The flange pose cannot be read.
        """
        T_base_flange = self._pose()
        if self._frames.is_slow and not self._waiting:
            return None
        self._frames.switch_dots(self._dots_on)
        if pictured:
            images = self._frames.render_both(T_base_flange)
            depth = images.depth
            picture = images.intensity
        else:
            depth = self._frames.render_depth(T_base_flange)
            picture = None
        match self._fault:
            case "zero":
                return ExposureImages(
                    began_s, np.zeros_like(depth), None if picture is None else np.zeros_like(picture)
                )
            case "constant":
                return ExposureImages(
                    began_s, np.full_like(depth, 5000), None if picture is None else np.full_like(picture, 99)
                )
            case "stale":
                return ExposureImages(began_s - STALE_S, depth, picture)
            case "silent":
                return None
            case _:
                return ExposureImages(began_s, depth, picture)

    def wait(self) -> bool:
        """Wait until the next image must be rendered. Frames whose time has passed are skipped.

        Returns:
            True for the next image. False after `end`.
        """
        with self._change:
            idle_s = time.monotonic() + IDLE_PERIOD_S
            while not self._ended:
                now_s = time.monotonic()
                late_s = now_s - self._due_s
                if late_s < 0:
                    self._change.wait(-late_s)
                    continue
                self._due_s += self._period_s * (late_s // self._period_s + 1)
                if self._waiting or now_s >= idle_s:
                    return True
        return False


def open_simulated(settings: SimulatedCamera, world: SimulatedWorld, make_pose: Callable[[], PoseSource]) -> Stream:
    """Start a pipeline whose images show a simulated world from the flange of an arm.

    Args:
        settings: Settings of the camera. The frame rate and the number of exposures are used.
        world: Simulated table and camera.
        make_pose: Connects to the arm's controller, and returns the source of the flange pose.

    Returns:
        The running pipeline and its queues.

    Raises:
        CameraUnreachableError: The flange pose cannot be read.
    """
    import_open3d()  # before depthai: after it, the import of open3d takes three times as long
    load()
    import depthai as dai

    try:
        pose = make_pose()
        pose()
    except (OSError, ValueError, EOFError) as error:
        raise CameraUnreachableError(
            f"the simulated camera cannot read the flange pose from the arm's controller: {error}"
        ) from error
    model = world.camera
    frames = FrameSource(world, ImageCache(settings.image_cache_bytes))
    imager = SimulatedImager(frames, pose, settings.frame_rate)
    # The images are those of the left camera, which is the reference of a stereo pair.
    extrinsics = dai.Extrinsics(np.eye(4).tolist(), dai.CameraBoardSocket.CAM_B)
    view = dai.ImgTransformation(
        model.width, model.height, model.K.tolist(), dai.CameraModel.Perspective, [0.0] * 14, extrinsics
    )

    closed: type[Exception] = dai.MessageQueue.QueueException

    class SimulatedOak(dai.node.ThreadedHostNode):
        """Node that sends depth images, and intensity images while its gate is open.

        The exposure time doubles at each image up to `EXPOSURE_US`, until the automatic exposure is locked.
        """

        def __init__(self) -> None:
            super().__init__()
            self.depth = self.createOutput()
            self.pictures = self.createOutput()
            self.control = self.createInput()
            self.gate = self.createInput()

        def run(self) -> None:
            try:
                self._run()
            except (closed, CameraLostError):
                # The pipeline is closing.
                return
            except OSError as error:
                imager.stop_reason = f"the simulated camera lost the flange pose: {error}"
            except Exception as error:
                # depthai would end the whole process at an uncaught exception.
                log.exception("the simulated camera ended")
                imager.stop_reason = f"the simulated camera ended: {type(error).__name__}: {error}"

        def _run(self) -> None:
            exposure_us, number, locked, gate_open = EXPOSURE_US / 8, 0, False, False
            while self.isRunning() and imager.wait():
                while not locked and (control := next_message(self.control, 0.0)) is not None:
                    locked = control.getCommand(dai.CameraControl.Command.AE_LOCK)
                began_s = time.monotonic()
                # an image passes the gate after its exposure, so a gate opened before it is open for it
                while (change := next_message(self.gate, 0.0)) is not None:
                    gate_open = change.open
                exposure_us = exposure_us if locked else min(exposure_us * 2, EXPOSURE_US)
                taken = imager.take(began_s, gate_open)
                if taken is None:
                    continue
                if taken.picture is not None:
                    self.pictures.send(self._message(taken.picture, taken.began_s, int(exposure_us), number))
                self.depth.send(self._message(taken.depth, taken.began_s, int(exposure_us), number))
                number += 1

        def _message(self, pixels: NDArray[Any], began_s: float, exposure_us: int, number: int) -> dai.ImgFrame:
            message = dai.ImgFrame()
            message.setType(dai.ImgFrame.Type.RAW16 if pixels.itemsize == 2 else dai.ImgFrame.Type.RAW8)
            message.setWidth(model.width)
            message.setHeight(model.height)
            message.setStride(pixels.itemsize * model.width)
            message.setData(pixels.astype(pixels.dtype.newbyteorder("<")).tobytes())
            message.setTransformation(view)
            message.setInstanceNum(int(dai.CameraBoardSocket.CAM_B.value))
            message.setSequenceNum(number)
            message.cam.exposureTimeUs = exposure_us
            # The time stamp of a real camera is the end of the exposure.
            message.setTimestamp(timedelta(seconds=began_s, microseconds=exposure_us))
            return message

    pipeline = dai.Pipeline(False)
    node = pipeline.create(SimulatedOak)
    depth = node.depth.createOutputQueue(maxSize=1, blocking=False)
    pictures = node.pictures.createOutputQueue(maxSize=settings.exposures + SPARE_PICTURES, blocking=False)
    controls, gate = [node.control.createInputQueue()], node.gate.createInputQueue()
    info = CameraInfo(
        product=f"simulated {model.name}",
        device_id=world.camera_id,
        width=model.width,
        height=model.height,
        connection="simulated",
        depth_unit_m=model.depth_unit_m,
        temperature_c=None,
        warnings=(),
    )

    def close() -> None:
        imager.end()
        pipeline.stop()
        # Wait for the thread of the node, so that the node does not send to a closed queue.
        pipeline.wait()

    pipeline.start()
    dots = imager.switch_dots if world.rendering.ir_dots > 0 else None
    return Stream(
        pipeline,
        depth,
        depth,
        controls,
        lambda: info,
        close,
        pictures,
        gate,
        depth_unit_m=model.depth_unit_m,
        dots=dots,
        fault_injection=imager,
    )
