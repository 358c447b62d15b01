"""File with the parameters of a simulated camera, as `pointchain camera-profile` writes it.

The file is a JSON object with the members of `CameraPreset`. Its parameters reproduce the depth of a measured camera.
"""

import json
import os
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import Field, ValidationError, field_validator

from cell.config.camera_optics import DOT_PROJECTORS, CameraOptics
from cell.config.rendering_options import TableTop
from cell.config.strict_model import Range, StrictSettings

MAX_BYTES = 1 << 20
"""Largest size of a camera file."""
DISPARITY_STEP = 16
"""The number of disparities of the matching is a multiple of this."""

StereoName = Literal["oak-d-pro", "oak-d-sr", "d435"]
"""Simulated cameras with rendered images."""
Source = Literal["measured", "default"]
"""Whether a parameter was measured, or is that of the camera on which the file is based."""


class CameraPresetError(ValueError):
    """The camera file cannot be read, or is not one."""

    slug = "camera-model"


class CameraPreset(StrictSettings):
    """Parameters of a simulated camera with rendered images."""

    format: Literal["pointchain-camera"] = "pointchain-camera"
    """Kind of the file."""
    schema_version: Literal[1] = 1
    """Version of the members."""
    base: StereoName
    """Simulated camera whose parameters hold where nothing was measured."""
    width: int = Field(ge=32, le=4096)
    """Width of the depth image, pixels."""
    height: int = Field(ge=20, le=4096)
    """Height of the depth image, pixels."""
    focal_px: float = Field(gt=0)
    """Focal length of the depth image, pixels."""
    depth_unit_m: float = Field(ge=1e-6, le=0.01)
    """Metres per depth count."""
    near_m: float = Field(gt=0, le=5.0)
    """Smallest distance that the camera measures."""
    working_m: Range
    """Smallest and largest distance from which strings are seen well."""
    baseline_m: float = Field(gt=0, le=1.0)
    """Distance between the cameras."""
    disparities: int = Field(ge=DISPARITY_STEP, le=1024, multiple_of=DISPARITY_STEP)
    """Number of whole disparities of the search."""
    block_px: int = Field(ge=3, le=25)
    """Side of the matching window, odd."""
    warp_px: float = Field(ge=0, le=10)
    """Root mean square of the slow disparity error over the image, pixels."""
    row_error_px: float = Field(ge=0, le=10)
    """Root mean square of the slow difference between the rows of both images, pixels."""
    bias_px: float = Field(ge=0, le=10)
    """Standard deviation of the disparity bias, pixels."""
    noise_factor: float = Field(ge=0, le=100)
    """Factor on the noise of the image sensors."""
    table_top: TableTop | None = None
    """Table top with the texture that the table had, or None to draw it from the seed."""
    sources: dict[str, Source] = Field(default_factory=dict)
    """Whether each parameter was measured, by its name."""
    notes: tuple[str, ...] = ()
    """What could not be measured or reproduced, and why."""
    measured: dict[str, Any] | None = None
    """Profile of the measured camera, as JSON."""
    reproduced: dict[str, Any] | None = None
    """Profile of the simulated camera with these parameters, as JSON."""

    @field_validator("block_px")
    @classmethod
    def _odd(cls, value: int) -> int:
        if value % 2 == 0:
            raise ValueError("the side of the matching window must be odd")
        return value

    @field_validator("working_m")
    @classmethod
    def _distances(cls, value: Range) -> Range:
        if not 0 < value[0] < value[1] <= 5.0:
            raise ValueError("the nearest and the farthest distance are needed, in metres, as [0.3, 0.6]")
        return value

    @property
    def name(self) -> str:
        """Name of the simulated camera."""
        return f"{self.base}-profile"

    @property
    def has_dots(self) -> bool:
        """Whether the camera has a dot projector."""
        return self.base in DOT_PROJECTORS

    def optics(self, working_m: Range | None) -> CameraOptics:
        """Return the optics of the camera.

        Args:
            working_m: Configured working range, or None for that of the file.
        """
        K = np.array(
            [
                [self.focal_px, 0.0, (self.width - 1) / 2],
                [0.0, self.focal_px, (self.height - 1) / 2],
                [0.0, 0.0, 1.0],
            ]
        )
        return CameraOptics(K, self.width, self.height, self.near_m, working_m or self.working_m)


def read_preset(path: str | os.PathLike[str]) -> CameraPreset:
    """Return the camera of a file.

    Raises:
        CameraPresetError: The file cannot be read, or is no camera file. The message says why.
    """
    path = Path(path)
    try:
        stat = path.stat()
        if not path.is_file():
            raise CameraPresetError(f"{path} is not a file: give the file that `pointchain camera-profile` wrote")
        if stat.st_size > MAX_BYTES:
            raise CameraPresetError(f"{path} is larger than {MAX_BYTES >> 20} MiB: it is no camera file")
    except OSError as error:
        raise CameraPresetError(f"the camera file {path} cannot be read: {error.strerror}") from error
    return _read(path, stat.st_mtime_ns)


@lru_cache(maxsize=8)
def _read(path: Path, _mtime_ns: int) -> CameraPreset:
    """Return the camera of a file, read again when the file has changed."""
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise CameraPresetError(f"the camera file {path} cannot be read: {error.strerror}") from error
    except (ValueError, RecursionError) as error:
        raise CameraPresetError(f"{path} is no camera file, because it is not JSON: {error}") from error
    if not isinstance(document, dict) or document.get("format") != "pointchain-camera":
        raise CameraPresetError(
            f'{path} is no camera file: its member "format" must be "pointchain-camera"; `pointchain camera-profile` '
            "makes such a file of a recording"
        )
    try:
        return CameraPreset.model_validate(document)
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(map(str, first["loc"])) or "the file"
        raise CameraPresetError(f"{path}: {where}: {first['msg']}; make the file again") from error


def to_text(preset: CameraPreset) -> str:
    """Return the content of a camera file."""
    return json.dumps(preset.model_dump(mode="json"), indent=2, allow_nan=False) + "\n"
