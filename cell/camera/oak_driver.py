"""Driver of an OAK depth camera, and of the simulated one, in a child process.

The two differ only in the pipeline that sends the images. The same code decodes, awaits and combines them.
"""

import logging
import time
from collections.abc import Callable
from dataclasses import replace
from datetime import timedelta
from math import inf
from typing import TYPE_CHECKING

from cell.camera.driver import Fault
from cell.camera.frame_averaging import Exposure, Picture, as_burst, combine, wait_for_exposures
from cell.camera.oak_stream import Stream, decode, decode_picture, next_message, send
from cell.config.camera_config import CameraSettings, OakCamera
from cell.devices import Burst, CameraInfo, Frame
from cell.errors import BadFrameError, CameraLostError, CameraUnreachableError, CellError

if TYPE_CHECKING:
    import depthai as dai

log = logging.getLogger(__name__)

FIRST_FRAME_S = 10.0
"""Longest time from opening a camera to its first image."""
SLICE_S = 0.25
"""Period at which a wait for an image checks whether the camera stopped."""
LATE_IMAGE_S = 0.1
"""Longest wait for left images after the last depth image of a capture. The camera sends them before the depth."""
STEADY_S = 4.0
"""Longest time for the exposure time to settle."""
STEADY_FOR_S, STEADY_IMAGES, STEADY_SHARE = 0.2, 3, 0.05
"""The exposure has settled when all images of this time, at least this number, have the same exposure time within this
share. The camera's control needs time to react, so that a few images at a high frame rate prove nothing."""


class OakDriver:
    """A `cell.camera.driver.CameraDriver` for depthai pipelines. It is made and used in the child process."""

    def __init__(self, settings: CameraSettings, open_stream: Callable[[], Stream]) -> None:
        """Create the driver; no device is used before `open`.

        Args:
            settings: Number of exposures, and the exposure time of a real camera.
            open_stream: Starts the pipeline. It raises CameraUnreachableError.
        """
        self._settings, self._open_stream = settings, open_stream
        self._stream: Stream | None = None
        self._warnings: tuple[str, ...] = ()
        """Warnings of opening the camera, in addition to those of its description."""

    def open(self) -> CameraInfo:
        """Start the camera, wait for its first image, and lock its exposure when it has settled.

        Raises:
            CameraUnreachableError: No camera answers, or it sends no images.
        """
        self._stream = stream = self._open_stream()
        try:
            stream.watch(True)
            wait_for_exposures(self._receive, time.monotonic(), 1, FIRST_FRAME_S, FIRST_FRAME_S)
            self._warnings = settle_exposure(stream, self._settings)
            return self.info()
        except (BadFrameError, CameraLostError) as error:
            raise CameraUnreachableError(f"the camera was found, but {error}") from error
        finally:
            stream.watch(False)

    def capture(self, after_s: float, silence_s: float, patience_s: float, with_image: bool = False) -> Frame:
        """Return the median of the configured number of exposures, as `CameraDriver.capture` says.

        The times hold for the depth images, and then again for the pictures of `with_image`, most of which have come by
        then.
        """
        stream = self._running()
        count = self._settings.exposures
        pictures: list[Picture] = []
        left_images: list[Picture] = []
        with stream.sending_pictures():
            after_s = max(after_s, time.monotonic())  # an earlier exposure may have been stopped at the gate
            stream.watch(True)
            try:
                self._drop_waiting_images()
                if not with_image:
                    exposures, left_images = self._receive_pairs(after_s, silence_s, patience_s)
                else:
                    exposures = wait_for_exposures(self._receive, after_s, count, silence_s, patience_s)
                    with stream.without_dots():
                        dark_s = -inf if stream.dots is None else time.monotonic()
                        pictures = wait_for_exposures(
                            self._receive_picture, max(after_s, dark_s), count, silence_s, patience_s, "picture"
                        )
            finally:
                stream.watch(False)
        return combine(exposures, stream.depth_unit_m, pictures, left_images)

    def burst(self, count: int, after_s: float, silence_s: float, patience_s: float) -> Burst:
        """Return single exposures, as `CameraDriver.burst` says."""
        stream = self._running()
        stream.watch(True)
        try:
            self._drop_waiting_images()
            exposures = wait_for_exposures(self._receive, after_s, count, silence_s, patience_s)
        finally:
            stream.watch(False)
        return as_burst(exposures, stream.depth_unit_m)

    def info(self) -> CameraInfo:
        """Return the camera's present state.

        Raises:
            CameraLostError: The camera does not answer.
        """
        stream = self._running()
        if stream.stop_reason:
            raise CameraLostError(stream.stop_reason)
        next_message(stream.depth, 0.0)  # raises if the link is broken
        if not stream.pipeline.isRunning():
            raise CameraLostError("the camera's pipeline has ended: check its cable and power supply")
        try:
            info = stream.describe()
        except RuntimeError as error:
            raise CameraLostError(f"the camera does not answer: check its cable and power supply ({error})") from error
        return replace(info, warnings=(*info.warnings, *self._warnings))

    def fault(self, kind: Fault) -> None:
        """Make a simulated camera fail from now on, until `none`.

        Raises:
            CellError: The camera is a real one.
        """
        stream = self._running()
        if stream.fault_injection is None:
            raise CellError("only a simulated camera fails on request")
        stream.fault_injection.fail(kind)
        if kind == "lost":
            stream.pipeline.stop()

    def close(self) -> None:
        """End the pipeline and release the device."""
        stream, self._stream = self._stream, None
        if stream is not None:
            stream.close()

    def _running(self) -> Stream:
        if self._stream is None:
            raise CameraLostError("the camera is not open")
        return self._stream

    def _drop_waiting_images(self) -> None:
        """Drop the images from before a call."""
        while self._receive(0.0) is not None:
            pass

    def _receive_pairs(
        self, after_s: float, silence_s: float, patience_s: float
    ) -> tuple[list[Exposure], list[Picture]]:
        """Return the exposures of a capture, and the left images of those whose image came too."""
        arrived: dict[int, Picture] = {}

        def receive(timeout_s: float) -> Exposure | None:
            exposure = self._receive(timeout_s)
            self._collect_left_images(arrived, after_s)  # the queue is short, so it is emptied after each depth image
            return exposure

        exposures = wait_for_exposures(receive, after_s, self._settings.exposures, silence_s, patience_s)
        end_s = time.monotonic() + LATE_IMAGE_S
        while any(exposure.number not in arrived for exposure in exposures) and time.monotonic() < end_s:
            self._collect_left_images(arrived, after_s)
        return exposures, [arrived[exposure.number] for exposure in exposures if exposure.number in arrived]

    def _collect_left_images(self, arrived: dict[int, Picture], after_s: float) -> None:
        """Add the waiting left images that began after `after_s` to `arrived`, by their numbers."""
        try:
            while (image := self._receive_picture(0.0)) is not None:
                if image.began_s > after_s:
                    arrived[image.number] = image
        except BadFrameError as error:
            log.warning("an intensity image is left out: %s", error)

    def _receive(self, timeout_s: float) -> Exposure | None:
        message = self._next(self._running().depth, timeout_s)
        return None if message is None else decode(message)

    def _receive_picture(self, timeout_s: float) -> Picture | None:
        message = self._next(self._running().pictures, timeout_s)
        return None if message is None else decode_picture(message)

    def _next(self, queue: "dai.MessageQueue", timeout_s: float) -> "dai.ImgFrame | None":
        message = next_message(queue, min(timeout_s, SLICE_S))
        stop_reason = self._running().stop_reason
        if message is None and stop_reason:
            raise CameraLostError(stop_reason)
        return message


def settle_exposure(stream: Stream, settings: CameraSettings) -> tuple[str, ...]:
    """Wait until the exposure time has settled, and lock it, so that the images of a scan are alike.

    A configured exposure time is only awaited.

    Returns:
        Warnings, if the exposure time has not settled.

    Raises:
        CameraLostError: The link to the camera broke.
    """
    import depthai as dai

    given_us = settings.exposure_us if isinstance(settings, OakCamera) else None
    needed = max(STEADY_IMAGES, 1 + round(STEADY_FOR_S * settings.frame_rate))
    end = time.monotonic() + STEADY_S + settings.rendering_s
    times_us: list[float] = []
    steady = False
    while not steady and (message := next_message(stream.timing, max(end - time.monotonic(), 0.0))) is not None:
        times_us = [*times_us[1 - needed :], message.getExposureTime() / timedelta(microseconds=1)]
        goal_us = times_us[-1] if given_us is None else given_us
        alike = all(abs(time_us - goal_us) <= STEADY_SHARE * goal_us for time_us in times_us)
        steady = alike and len(times_us) == needed
        if time.monotonic() > end:
            break
    if given_us is None:
        for control in stream.controls:
            send(control, dai.CameraControl().setAutoExposureLock(True))
    if steady:
        return ()
    latest = f"{times_us[-1]:.0f}" if times_us else "unknown"
    expected = "still changes" if given_us is None else f"should be {given_us}"
    return (f"the exposure time is {latest} microseconds and {expected}: is the light steady?",)
