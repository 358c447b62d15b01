"""Drives an OAK depth camera, or the simulated one, in a child process of its own.

Only what makes the pipeline differs between the two; what comes out of it is decoded, awaited and combined by the same
code.
"""

import time
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import replace
from datetime import timedelta
from math import inf
from typing import TYPE_CHECKING

from cell.camera.frame_averaging import Exposure, Picture, at_rest, combined
from cell.camera.oak_stream import DEPTH_UNIT_M, Fault, Stream, decode, decode_picture, next_message, send
from cell.config.camera_config import OakCamera
from cell.config.cell_config import AnyCamera
from cell.devices import CameraInfo, Frame
from cell.errors import BadFrameError, CameraLostError, CameraUnreachableError, CellError

if TYPE_CHECKING:
    import depthai as dai

    from cell.simulation.devices.flange_pose import PoseSource
    from cell.simulation.devices.world import SimulatedWorld

FIRST_FRAME_S = 10.0
"""How long a camera that was found may take to its first image."""
SLICE_S = 0.25
"""While an image is waited for, so often it is looked whether any can come."""
STEADY_S = 4.0
"""How long the exposure time may take to settle."""
STEADY_IMAGES, STEADY_SHARE = 3, 0.05
"""It has settled when so many images in a row have the same, within this share."""


class OakDriver:
    """The driver: made and used in the child process."""

    def __init__(
        self,
        settings: AnyCamera,
        world: "SimulatedWorld | None" = None,
        make_pose: "Callable[[], PoseSource] | None" = None,
    ) -> None:
        """`world` and `make_pose` are what a simulated camera sees, and how it learns where the flange is."""
        self._settings, self._world, self._make_pose = settings, world, make_pose
        self._stream: Stream | None = None
        self._warnings: tuple[str, ...] = ()
        """Of opening the camera, beside those that it describes itself with."""

    def open(self) -> CameraInfo:
        """Starts the camera, waits for its first image, and lets its exposure settle and locks it.

        Raises:
            CameraUnreachableError: there is no camera, or it gives no images.
        """
        self._stream = stream = self._start()
        try:
            stream.watch(True)
            at_rest(self._receive, time.monotonic(), 1, FIRST_FRAME_S, FIRST_FRAME_S)
            self._warnings = settle_exposure(stream, self._settings)
            return self.info()
        except (BadFrameError, CameraLostError) as error:
            raise CameraUnreachableError(f"the camera was found, but {error}") from error
        finally:
            stream.watch(False)

    def capture(self, after_s: float, silence_s: float, patience_s: float, image: bool = False) -> Frame:
        """As `cell.devices.Camera.capture`; the times are those of
        `cell.camera.frame_averaging.at_rest`, for the depth images and then once more for the pictures, most of which
        have come by then."""
        stream = self._running()
        count = self._settings.exposures
        pictures: list[Picture] = []
        stream.watch(True)
        try:
            while self._receive(0.0) is not None:
                pass  # of before the call
            with stream.sending_pictures() if image else nullcontext():
                exposures = at_rest(self._receive, after_s, count, silence_s, patience_s)
                if image:
                    with stream.without_dots():
                        lit_s = -inf if stream.dots is None else time.monotonic()
                        pictures = at_rest(
                            self._receive_picture, max(after_s, lit_s), count, silence_s, patience_s, "picture"
                        )
        finally:
            stream.watch(False)
        return combined(exposures, DEPTH_UNIT_M, pictures)

    def info(self) -> CameraInfo:
        """The camera now. Raises CameraLostError."""
        stream = self._running()
        if stream.trouble:
            raise CameraLostError(stream.trouble)
        next_message(stream.depth, 0.0)  # raises if the link is broken
        if not stream.pipeline.isRunning():
            raise CameraLostError("the camera's pipeline has ended: check its cable and power supply")
        try:
            info = stream.describe()
        except RuntimeError as error:
            raise CameraLostError(f"the camera does not answer: check its cable and power supply ({error})") from error
        return replace(info, warnings=(*info.warnings, *self._warnings))

    def fault(self, kind: Fault) -> None:
        """Lets a simulated camera fail from now on, until `none`."""
        stream = self._running()
        if stream.rehearsal is None:
            raise CellError("only a simulated camera fails on request")
        stream.rehearsal.fail(kind)
        if kind == "lost":
            stream.pipeline.stop()

    def close(self) -> None:
        """Ends the pipeline and lets the device go."""
        stream, self._stream = self._stream, None
        if stream is not None:
            stream.close()

    def _start(self) -> Stream:
        if isinstance(self._settings, OakCamera):
            from cell.camera.oak_device import open_device

            return open_device(self._settings)
        from cell.simulation.devices.oak_pipeline import open_simulated

        if self._world is None or self._make_pose is None:
            raise CameraUnreachableError("a simulated camera needs a simulated world and an arm")
        return open_simulated(self._settings, self._world, self._make_pose)

    def _running(self) -> Stream:
        if self._stream is None:
            raise CameraLostError("the camera is not open")
        return self._stream

    def _receive(self, wait_s: float) -> Exposure | None:
        message = self._next(self._running().depth, wait_s)
        return None if message is None else decode(message)

    def _receive_picture(self, wait_s: float) -> Picture | None:
        message = self._next(self._running().pictures, wait_s)
        return None if message is None else decode_picture(message)

    def _next(self, queue: "dai.MessageQueue", wait_s: float) -> "dai.ImgFrame | None":
        message = next_message(queue, min(wait_s, SLICE_S))
        trouble = self._running().trouble
        if message is None and trouble:
            raise CameraLostError(trouble)
        return message


def settle_exposure(stream: Stream, settings: AnyCamera) -> tuple[str, ...]:
    """Waits until the exposure time has settled and locks it: the images of a scan shall be alike. Returns warnings.

    An exposure time that the settings give is only waited for. Raises CameraLostError.
    """
    import depthai as dai

    given_us = settings.exposure_us if isinstance(settings, OakCamera) else None
    end = time.monotonic() + STEADY_S
    times_us: list[float] = []
    steady = False
    while not steady and (message := next_message(stream.timing, max(end - time.monotonic(), 0.0))) is not None:
        times_us = [*times_us[1 - STEADY_IMAGES :], message.getExposureTime() / timedelta(microseconds=1)]
        goal_us = times_us[-1] if given_us is None else given_us
        alike = all(abs(time_us - goal_us) <= STEADY_SHARE * goal_us for time_us in times_us)
        steady = alike and len(times_us) == STEADY_IMAGES
        if time.monotonic() > end:
            break
    if given_us is None:
        for control in stream.controls:
            send(control, dai.CameraControl().setAutoExposureLock(True))
    if steady:
        return ()
    latest = f"{times_us[-1]:.0f}" if times_us else "unknown"
    wish = "still changes" if given_us is None else f"should be {given_us}"
    return (f"the exposure time is {latest} microseconds and {wish}: is the light steady?",)
