"""The depth camera as a scan sees it: a child process with the driver in it."""

import logging
import threading
import time
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any

from cell.camera.frame_averaging import NoFramesError
from cell.camera.oak_driver import OakDriver
from cell.camera.oak_stream import DEPTH_UNIT_M, Fault
from cell.config.camera_config import OakCamera
from cell.config.cell_config import AnyCamera
from cell.devices import CameraInfo, Frame
from cell.errors import CameraLostError, CameraUnreachableError
from cell.process.child import Child, ChildLostError, NotCalledError
from cell.simulation.devices.flange_pose import PoseSource, controller_pose

if TYPE_CHECKING:
    from cell.simulation.devices.world import SimulatedWorld

log = logging.getLogger(__name__)

OPEN_S = 30.0
"""A camera in a network takes up to half of it to start."""
OPEN_SIMULATED_S = 60.0
"""A busy machine takes its time to load and build what a simulated camera sees."""
ASK_S = 3.0
"""How long the driver may take for an answer that needs no image."""
SILENCE_S = 2.0
"""So long without any image, beyond what the frame rate makes, is too long."""


class LiveCamera:
    """A `cell.devices.Camera`: an OAK, or the simulated one. Belongs to one thread, but for `give_up_connecting`."""

    def __init__(
        self,
        settings: AnyCamera,
        world: "SimulatedWorld | None" = None,
        controller_host: Callable[[], str] | None = None,
        pose_of: Callable[[str], PoseSource] = controller_pose,
    ) -> None:
        """Touches no device. The rest is for a simulated camera: the `world` it sees, and at connecting
        `controller_host()` is asked where the arm's controller listens, of which `pose_of(host)` knows the flange.
        """
        self.settings = settings
        self._world = world
        self._controller_host = controller_host
        self._pose_of = pose_of
        self._child: Child | None = None
        self._driver: Callable[[], OakDriver] | None = None
        self._device_id: str | None = None
        self._opening: Child | None = None
        self._given_up = threading.Event()

    @property
    def connected(self) -> bool:
        """It is open, as far as anyone has noticed; `info` finds out."""
        return self._child is not None and self._child.alive

    @property
    def depth_unit_m(self) -> float:
        """Metres per depth count of what `capture` gives."""
        return DEPTH_UNIT_M

    @property
    def pid(self) -> int | None:
        """Of the driver's process, if there is one."""
        return None if self._child is None else self._child.pid

    def connect(self) -> CameraInfo:
        """Opens the camera and waits for its first frame; one that was open is opened anew.

        Raises:
            CameraUnreachableError: no camera answers, or not the configured one; it says what to check.
            CellError: what `controller_host` raises.
        """
        self.close()
        make_pose = None
        if self._controller_host is not None and not isinstance(self.settings, OakCamera):
            make_pose = partial(self._pose_of, self._controller_host())
        self._driver = partial(OakDriver, self.settings, self._world, make_pose)
        info = self._open()
        self._device_id = info.device_id
        return info

    def capture(self, after_s: float, image: bool = False) -> Frame:
        """The scene at rest: only exposures that began after `after_s`, seconds of `time.monotonic()`; with a picture
        if `image`.

        A camera that was lost or is silent is connected anew once, and then has another try: the arm is at rest.

        Raises:
            CameraLostError: it is lost, also after that.
            BadFrameError: it gives images that show nothing, or none.
        """
        if self._driver is None:
            raise CameraLostError("the camera is not connected")
        try:
            return self._capture(after_s, image)
        except (CameraLostError, NoFramesError) as error:
            log.warning("%s; connecting the camera once more", error)
            lost = error
        try:
            self._reopen()
            return self._capture(after_s, image)
        except CameraUnreachableError as error:
            self._end()
            raise CameraLostError(f"{lost}. It could not be connected again: {error}") from error

    def info(self) -> CameraInfo:
        """The camera now. Raises CameraLostError; it is then no longer connected."""
        return self._call("info", timeout_s=ASK_S)

    def fault(self, kind: Fault) -> None:
        """Lets a simulated camera fail, until `none` or until it is connected anew. Raises CellError on a real one."""
        self._call("fault", kind, timeout_s=ASK_S)

    def give_up_connecting(self) -> None:
        """From any thread: a connecting that is under way fails at once, and so does every later one.

        A camera that is open stays so. For whoever closes everything and would else wait until a camera has started.
        """
        self._given_up.set()  # first: a process that is not asked yet to open the camera will not be
        opening = self._opening
        if opening is not None:
            opening.kill()

    def close(self) -> None:
        """Lets the camera go; leaves no process behind."""
        self._end()
        self._driver = self._device_id = None

    def _capture(self, after_s: float, image: bool) -> Frame:
        count, fps = self.settings.exposures, self.settings.fps
        silence_s = SILENCE_S + 2 / fps
        # Three times as long as the frame rate promises: frames get lost where the link is poor.
        patience_s = SILENCE_S + 3 * (count + 1) / fps
        until_s = max(after_s - time.monotonic(), 0.0) + (2 if image else 1) * patience_s + ASK_S
        return self._call("capture", after_s, silence_s, patience_s, image, timeout_s=until_s)

    def _reopen(self) -> None:
        self._end()
        info = self._open()
        if info.device_id != self._device_id:
            raise CameraUnreachableError(
                f"another camera answers: {info.product} {info.device_id} instead of {self._device_id}"
            )

    def _open(self) -> CameraInfo:
        assert self._driver is not None
        self._child = self._opening = Child("camera", self._driver)
        limit_s = OPEN_S if isinstance(self.settings, OakCamera) else OPEN_SIMULATED_S
        try:
            return self._child.call("open", timeout_s=limit_s, unless=self._given_up)
        except (ChildLostError, NotCalledError) as error:
            self._end()
            if self._given_up.is_set():
                raise CameraUnreachableError(
                    "connecting the camera was given up, as the cell is being closed"
                ) from error
            raise CameraUnreachableError(f"the camera's driver did not start, as {error}") from error
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
            raise CameraLostError(f"the camera was lost, as {error}") from error
        except CameraLostError:
            self._end()  # what is lost is no longer connected
            raise
