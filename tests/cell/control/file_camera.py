"""A third kind of camera in one file: its settings, its driver and its entry in the table of kinds.

It is what docs/contributor/adding-a-device.md describes, for a camera whose vendor writes each image to a file.
"""

import time
from functools import partial
from pathlib import Path
from typing import Literal

import numpy as np

from cell.camera.driver import Fault
from cell.camera.frame_averaging import Exposure, as_burst, combine
from cell.config.camera_config import CameraSettings
from cell.config.camera_optics import CameraOptics
from cell.control.equipment import CameraKind
from cell.devices import Burst, CameraInfo, Frame
from cell.errors import CameraLostError, CameraUnreachableError, CellError

K = np.array([[440.0, 0.0, 319.5], [0.0, 440.0, 199.5], [0.0, 0.0, 1.0]])
DEPTH_UNIT_M = 0.0005


class FileCamera(CameraSettings):
    """A camera that writes its depth images to a folder."""

    kind: Literal["file"] = "file"
    """Selects this kind."""
    folder: Path
    """Folder with depth images as NPY files."""

    @property
    def optics(self) -> CameraOptics:
        """Nominal optics."""
        return CameraOptics(K, 640, 400, 0.1, self.working_m or (0.25, 0.6))

    @property
    def device_id(self) -> str:
        """Device id."""
        return "file-1"

    @property
    def summary(self) -> str:
        """Folder."""
        return f"depth images in {self.folder}"


class FileDriver:
    """A `cell.camera.driver.CameraDriver` that reads the files in the order of their names."""

    def __init__(self, settings: FileCamera) -> None:
        self._settings = settings
        self._files: list[Path] = []

    def open(self) -> CameraInfo:
        """Find the files. Raise CameraUnreachableError if there are none."""
        self._files = sorted(self._settings.folder.glob("*.npy"))
        if not self._files:
            raise CameraUnreachableError(f"there are no images in {self._settings.folder}: check camera.folder")
        return self.info()

    def capture(self, after_s: float, silence_s: float, patience_s: float, with_image: bool = False) -> Frame:
        """Return the next file as a frame. Raise CameraLostError after the last one."""
        return combine([self._next(after_s)] * self._settings.exposures, DEPTH_UNIT_M)

    def burst(self, count: int, after_s: float, silence_s: float, patience_s: float) -> Burst:
        """Return the next files. Raise CameraLostError if there are too few."""
        return as_burst([self._next(after_s) for _ in range(count)], DEPTH_UNIT_M)

    def info(self) -> CameraInfo:
        """Describe the camera."""
        return CameraInfo(
            product="file camera",
            device_id=self._settings.device_id,
            width=640,
            height=400,
            connection="files",
            temperature_c=None,
            warnings=(),
            depth_unit_m=DEPTH_UNIT_M,
            has_images=False,
        )

    def fault(self, kind: Fault) -> None:
        """Raise CellError: this camera does not fail on request."""
        raise CellError("only a simulated camera fails on request")

    def close(self) -> None:
        """Forget the files."""
        self._files = []

    def _next(self, after_s: float) -> Exposure:
        """Return the next file. Raise CameraLostError after the last one."""
        time.sleep(max(after_s - time.monotonic(), 0.0))
        if not self._files:
            raise CameraLostError(f"there are no more images in {self._settings.folder}")
        return Exposure(np.load(self._files.pop(0)), K, time.monotonic())


KIND = CameraKind(lambda camera, _: partial(FileDriver, camera), open_timeout_s=30.0)
