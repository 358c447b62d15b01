"""The depth camera of a scan: a child process with the camera's driver."""

import logging
import threading
import time
from collections.abc import Callable
from typing import Any, TypeVar

from cell.camera.driver import CameraDriver, Fault
from cell.camera.frame_averaging import NoFramesError
from cell.config.camera_config import CameraSettings
from cell.devices import Burst, CameraInfo, Frame
from cell.errors import CameraLostError, CameraUnreachableError
from cell.process.child import Child, ChildLostError, NotCalledError

log = logging.getLogger(__name__)

ASK_S = 3.0
"""Timeout of a call that needs no image."""
SILENCE_S = 2.0
"""Longest time without an image, in addition to the period of the frame rate."""

T = TypeVar("T")

MakeDriver = Callable[[], CameraDriver]
"""Makes the driver. It is called in the child process and must be picklable."""


class LiveCamera:
    """A `cell.devices.Camera` whose driver runs in a child process.

    Every method but `cancel_connecting` belongs to one thread at a time.
    """

    def __init__(
        self, settings: CameraSettings, prepare_driver: Callable[[], MakeDriver], open_timeout_s: float
    ) -> None:
        """Create the camera; no device is used before `connect`.

        Args:
            settings: Number of exposures and frame rate.
            prepare_driver: Called at each `connect`, in this process. It returns what makes the driver.
            open_timeout_s: Timeout of the driver's start and of opening the camera.
        """
        self.settings = settings
        self._prepare_driver, self._open_timeout_s = prepare_driver, open_timeout_s
        self._child: Child | None = None
        self._make_driver: MakeDriver | None = None
        self._device_id: str | None = None
        self._opening: Child | None = None
        self._cancelled = threading.Event()

    @property
    def connected(self) -> bool:
        """Whether the camera is open and its process alive. Only `info` finds out whether the camera answers."""
        return self._child is not None and self._child.alive

    @property
    def pid(self) -> int | None:
        """Process id of the driver, or None without a driver."""
        return None if self._child is None else self._child.pid

    def connect(self) -> CameraInfo:
        """Open the camera and wait for its first frame. An open camera is closed first.

        Raises:
            CameraUnreachableError: No camera answers, or not the configured one.
            CellError: An error of `prepare_driver`.
        """
        self.close()
        self._make_driver = self._prepare_driver()
        info = self._open()
        self._device_id = info.device_id
        return info

    def capture(self, after_s: float, with_image: bool = False) -> Frame:
        """Capture the scene at rest.

        A camera that is lost or silent is connected again once. This is safe, because the arm is at rest.

        Args:
            after_s: Earliest start of an exposure, seconds of `time.monotonic()`.
            with_image: Whether the frame has an `image` for a calibration, in place of `intensity`.

        Raises:
            CameraLostError: The camera is lost, also after a new connection.
            BadFrameError: The images show nothing, or none came.
        """
        return self._with_new_connection(lambda: self._capture(after_s, with_image))

    def burst(self, count: int, after_s: float) -> Burst:
        """Return single exposures of the scene at rest. A lost or silent camera is connected again once.

        Args:
            count: Number of exposures.
            after_s: Earliest start of an exposure, seconds of `time.monotonic()`.

        Raises:
            CameraLostError: The camera is lost, also after a new connection.
            BadFrameError: The images differ in size, or none came.
        """
        return self._with_new_connection(lambda: self._burst(count, after_s))

    def info(self) -> CameraInfo:
        """Return the camera's present state.

        Raises:
            CameraLostError: The camera does not answer. It is then no longer connected.
        """
        return self._call("info", timeout_s=ASK_S)

    def fault(self, kind: Fault) -> None:
        """Make a simulated camera fail, until `none` or until it is connected again.

        Raises:
            CellError: The camera is a real one.
        """
        self._call("fault", kind, timeout_s=ASK_S)

    def cancel_connecting(self) -> None:
        """Let the current and every later connection fail at once. It may be called from any thread.

        An open camera stays open. A caller that closes the cell need not wait for a camera to start.
        """
        self._cancelled.set()  # first: a child that was not asked to open the camera yet will not be asked
        opening = self._opening
        if opening is not None:
            opening.kill()

    def close(self) -> None:
        """Release the camera and end its process."""
        self._end()
        self._make_driver = self._device_id = None

    def _with_new_connection(self, request: Callable[[], T]) -> T:
        """Return the answer to a request. Connect the camera again, once, if it is lost or silent."""
        if self._make_driver is None:
            raise CameraLostError("the camera is not connected")
        try:
            return request()
        except (CameraLostError, NoFramesError) as error:
            log.warning("%s; connecting the camera again", error)
            lost = error
        try:
            self._reopen()
            return request()
        except CameraUnreachableError as error:
            self._end()
            raise CameraLostError(f"{lost}. It could not be connected again: {error}") from error

    def _limits_s(self, count: int) -> tuple[float, float]:
        """Return the longest time without an image, and the longest time until `count` exposures are there."""
        fps = self.settings.frame_rate
        longest_s = SILENCE_S + self.settings.rendering_s
        # Three times the nominal duration: frames get lost on a poor link.
        return longest_s + 2 / fps, longest_s + 3 * (count + 1) / fps

    def _burst(self, count: int, after_s: float) -> Burst:
        silence_s, patience_s = self._limits_s(count)
        timeout_s = max(after_s - time.monotonic(), 0.0) + patience_s + ASK_S
        return self._call("burst", count, after_s, silence_s, patience_s, timeout_s=timeout_s)

    def _capture(self, after_s: float, with_image: bool) -> Frame:
        silence_s, patience_s = self._limits_s(self.settings.exposures)
        timeout_s = max(after_s - time.monotonic(), 0.0) + (2 if with_image else 1) * patience_s + ASK_S
        return self._call("capture", after_s, silence_s, patience_s, with_image, timeout_s=timeout_s)

    def _reopen(self) -> None:
        self._end()
        info = self._open()
        if info.device_id != self._device_id:
            raise CameraUnreachableError(
                f"another camera answers: {info.product} {info.device_id} instead of {self._device_id}"
            )

    def _open(self) -> CameraInfo:
        assert self._make_driver is not None
        self._child = self._opening = Child("camera", self._make_driver)
        try:
            return self._child.call("open", timeout_s=self._open_timeout_s, unless=self._cancelled)
        except (ChildLostError, NotCalledError) as error:
            self._end()
            if self._cancelled.is_set():
                raise CameraUnreachableError(
                    "the connection of the camera was cancelled, because the cell is being closed"
                ) from error
            raise CameraUnreachableError(f"the camera's driver did not start: {error}") from error
        except BaseException:
            self._end()
            raise
        finally:
            self._opening = None

    def _end(self) -> None:
        child, self._child = self._child, None
        if child is not None:
            child.close()

    def _call(self, method: str, *arguments: object, timeout_s: float) -> Any:
        if self._child is None:
            raise CameraLostError("the camera is not connected")
        try:
            return self._child.call(method, *arguments, timeout_s=timeout_s)
        except ChildLostError as error:
            self._end()
            raise CameraLostError(f"the camera was lost: {error}") from error
        except CameraLostError:
            self._end()  # a lost camera is not connected
            raise
