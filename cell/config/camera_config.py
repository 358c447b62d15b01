"""Settings of the camera: model, exposure, working distance."""

from abc import abstractmethod
from pathlib import Path
from typing import Literal, Self

from pydantic import Field, field_validator, model_validator

from cell.config.camera_names import DEFAULT_CAMERA, CameraName
from cell.config.camera_optics import (
    DOT_PROJECTORS,
    STEREO_BASELINES_M,
    CameraOptics,
    OakProduct,
    oak_max_fps,
    oak_optics,
    simulated_optics,
)
from cell.config.camera_preset import CameraPreset, read_preset
from cell.config.rendering_options import RenderingOptions, Sheath, TableTop
from cell.config.strict_model import Range, StrictSettings, Vector3
from recognition.parameters import R_MAX, R_MIN

SCENES = (
    "straight",
    "arc",
    "loop",
    "figure-eight",
    "overhand-knot",
    "coil",
    "several",
    "random",
    "tangle",
    "settled",
    "mixed-radii",
    "ring",
    "stacked",
    "side-by-side",
    "end-on-strand",
    "long",
    "empty",
    "bar",
    "plate",
    "post",
    "slot",
    "wall",
)
"""Names of the scenes of a simulated camera, each with its generator in `cell.simulation.scenes`."""


MAX_FPS = 60.0
"""Largest frame rate that can be configured."""
DEFAULT_FPS = 30.0
"""Frame rate without `camera.fps`, if the product reaches it. Its period just exceeds the longest `exposure_us`."""


class CameraSettings(StrictSettings):
    """Settings that every kind of camera has."""

    # A subclass also adds `kind`, by which a configuration names it.

    # 5 exposures take 0.07 s a view more than 3 at 30 images/s, and drop one more wrong depth of a pixel.
    exposures: int = Field(default=5, ge=1, le=25)
    """Number of depth images per view. Their median is the view: it drops up to 2 wrong depths of a pixel out of 5.
    `pointchain check` measures whether fewer are enough."""
    fps: float | None = Field(default=None, ge=1.0, le=MAX_FPS)
    """Frame rate of the camera. The default is 30, or the limit of the product at its resolution if that is lower."""
    settle_s: float = Field(default=0.1, ge=0.0, le=5.0)
    """Waiting time between the end of a move and the first exposure."""
    working_m: Range | None = None
    """Nearest and farthest distance between camera and workspace. The default depends on the camera model."""
    body_m: Vector3 = (0.10, 0.04, 0.04)
    """Size of the camera body along its x, y and z axes, for collision checks."""

    @property
    @abstractmethod
    def optics(self) -> CameraOptics:
        """Nominal optics, with which viewpoints are planned."""

    @property
    def max_fps(self) -> float:
        """Largest frame rate of the camera with these settings, images/s."""
        return MAX_FPS

    @property
    def frame_rate(self) -> float:
        """Frame rate of the camera, images/s: `fps`, or its default."""
        return min(DEFAULT_FPS, self.max_fps) if self.fps is None else self.fps

    @property
    def rendering_s(self) -> float:
        """Longest time in which a simulated camera renders the images of a view, seconds. It is 0 for a real camera."""
        return 0.0

    @property
    @abstractmethod
    def device_id(self) -> str | None:
        """Device id of the camera, or None if the settings do not determine it."""

    @property
    @abstractmethod
    def summary(self) -> str:
        """Short description of the camera for a report."""

    @field_validator("working_m")
    @classmethod
    def _distances(cls, value: Range | None) -> Range | None:
        if value is not None and not 0 < value[0] < value[1] <= 5.0:
            raise ValueError("the nearest and the farthest distance are needed, in metres, as [0.3, 0.6]")
        return value

    @field_validator("body_m")
    @classmethod
    def _size(cls, value: Vector3) -> Vector3:
        if not (min(value) > 0 and max(value) <= 1.0):
            raise ValueError("width, height and depth are needed, in metres, as [0.10, 0.04, 0.04]")
        return value


RENDERING_S = 10.0
"""Time in which a simulated camera renders and matches the images of a view, on a busy machine too.

A view of `oak-d-sr` takes 3 s of a core.
"""


IMAGE_CACHE_BYTES = 500_000_000
"""Default size of the rendered images that are kept between runs: 240 views at 640x400."""


def simulated_camera_id(model: str, seed: int) -> str:
    """Return the device id that a simulated camera reports."""
    return f"simulated-{model}-{seed}"


class SimulatedCamera(CameraSettings):
    """A simulated depth camera, which views a simulated scene."""

    kind: Literal["simulated"] = "simulated"
    """Selects the simulated camera."""
    model: CameraName = DEFAULT_CAMERA
    """Model of the camera. `oak-d-pro`, `oak-d-sr` and `d435` match their depth in rendered images, with the figures of
    these products. `ideal` has the depth of a noise model, with the figures of an OAK-D Pro. `ideal-sr` has the figures
    of an OAK-D SR, and `ideal-measured` adds measured errors to `ideal`. `exact` has no depth noise."""
    profile: Path | None = None
    """Camera file that `pointchain camera-profile` made of a recording. The camera then has its parameters instead of
    those of `model`. A relative path in the file counts from its folder; in a variable, from the working directory."""
    scene: str = "figure-eight"
    """Name of the scene, as in `pointchain simulate`."""
    seed: int = Field(default=3, ge=0)
    """Random seed of the scene, of the noise and of the errors."""
    string_radius_m: float = Field(default=0.0042, ge=R_MIN, le=R_MAX)
    """Radius of the simulated strings."""
    errors: float = Field(default=1.0, ge=0.0, le=100.0)
    """Factor on the errors of arm and calibration. 1 is a good cell, 0 a perfect one."""
    sheath: Sheath | None = None
    """Surface of the strings in rendered images. The default is drawn from `seed` among those with texture. Only
    `oak-d-pro`, `oak-d-sr` and `d435` render images."""
    table_top: TableTop | None = None
    """Surface of the table in rendered images. The default is drawn from `seed` among those with texture."""
    ir_dots: float = Field(default=0.0, ge=0.0, le=1.0)
    """Power of the simulated dot projector, as a share of its maximum. `oak-d-pro` and `d435` have a projector."""
    image_cache_bytes: int = Field(default=IMAGE_CACHE_BYTES, ge=0)
    """Largest size of the rendered images that are kept on the disk between runs, in the cache folder of the user. They
    do not have to be rendered again. 0 keeps none."""

    @field_validator("profile")
    @classmethod
    def _absolute(cls, value: Path | None) -> Path | None:
        return None if value is None else value.expanduser().absolute()

    @field_validator("scene")
    @classmethod
    def _known(cls, value: str) -> str:
        if value not in SCENES:
            raise ValueError(f"the scenes are {', '.join(SCENES)}")
        return value

    @model_validator(mode="after")
    def _has_options(self) -> Self:
        preset = self.preset
        if preset is None:
            self.rendering.check(self.model, self.model in STEREO_BASELINES_M, self.model in DOT_PROJECTORS)
            return self
        if "model" in self.model_fields_set and self.model != preset.base:
            raise ValueError(
                f"model is {self.model}, but profile is a camera file that is based on {preset.base}: remove model"
            )
        self.rendering.check(preset.name, True, preset.has_dots)
        return self

    @property
    def preset(self) -> CameraPreset | None:
        """Camera of the file `profile`, or None without one."""
        return None if self.profile is None else read_preset(self.profile)

    @property
    def camera_name(self) -> str:
        """Name of the simulated camera."""
        return self.model if self.preset is None else self.preset.name

    @property
    def rendering_s(self) -> float:
        """Longest time in which the images of a view are rendered on a busy machine, seconds."""
        is_rendered = self.preset is not None or self.model in STEREO_BASELINES_M
        return RENDERING_S if is_rendered else 0.0

    @property
    def rendering(self) -> RenderingOptions:
        """Options of the rendered images."""
        return RenderingOptions(self.sheath, self.table_top, self.ir_dots)

    @property
    def optics(self) -> CameraOptics:
        """Nominal optics, which are exact for a simulated camera."""
        if self.preset is not None:
            return self.preset.optics(self.working_m)
        return simulated_optics(self.model, self.working_m)

    @property
    def device_id(self) -> str:
        """Device id that the simulated camera reports."""
        return simulated_camera_id(self.camera_name, self.seed)

    @property
    def summary(self) -> str:
        """Model and scene."""
        return f"simulated {self.camera_name} camera that sees {self.scene}"


class OakCamera(CameraSettings):
    """A Luxonis OAK depth camera."""

    kind: Literal["oak"]
    """Selects an OAK camera."""
    device: str | None = None
    """Device id, or IP address of a camera on the network. Without it, the only camera on USB is taken."""
    product: OakProduct = "oak-d-pro"
    """Product. Viewpoints are planned with its optics. `oak-d-pro` also stands for OAK-D S2 and the PoE models."""
    width: int = Field(default=640, ge=320, le=1280)
    """Width of the depth image."""
    height: int = Field(default=400, ge=200, le=800)
    """Height of the depth image, at most 10/16 of the width."""
    extended_disparity: bool = False
    """Extended disparity, which measures shorter distances. `oak-d-sr` does not have it."""
    exposure_us: int | None = Field(default=None, ge=1, le=33_000)
    """Exposure time. Without it, the camera finds the exposure once and locks it."""
    iso: int = Field(default=400, ge=100, le=1600)
    """Sensor gain. It has an effect only together with `exposure_us`."""
    ir_dots: float = Field(default=0.0, ge=0.0, le=1.0)
    """Power of the infrared dot projector, as a share of its maximum. Only some products have a projector."""

    @model_validator(mode="after")
    def _exists(self) -> Self:
        if self.extended_disparity and self.product == "oak-d-sr":
            raise ValueError("extended_disparity is set, but an oak-d-sr has none")
        if self.height * 16 > self.width * 10:
            raise ValueError(f"there are no images of {self.width}x{self.height}; at most 10/16 as high as wide")
        if self.fps is not None and self.fps > self.max_fps:
            mode = " and extended_disparity" if self.extended_disparity else ""
            raise ValueError(
                f"fps is {self.fps:g}, but an {self.product} sends at most {self.max_fps:g} depth images/s with "
                f"{self.width}x{self.height}{mode}"
            )
        if self.exposure_us is not None and self.exposure_us > 1e6 / self.frame_rate:
            raise ValueError(
                f"exposure_us is {self.exposure_us}, but there are only {1e6 / self.frame_rate:.0f} microseconds from "
                f"image to image with fps {self.frame_rate:g}"
            )
        return self

    @property
    def optics(self) -> CameraOptics:
        """Optics by the data sheet of the product."""
        return oak_optics(self.product, self.width, self.height, self.extended_disparity, self.working_m)

    @property
    def max_fps(self) -> float:
        """Largest frame rate by the tables of the vendor, images/s."""
        return min(MAX_FPS, oak_max_fps(self.product, self.width, self.height, self.extended_disparity))

    @property
    def device_id(self) -> str | None:
        """Device id of the camera, or None if `device` is an address or is not set."""
        # An IP address or a USB port has dots or colons; a device id has none.
        return self.device if self.device is not None and self.device.isalnum() else None

    @property
    def summary(self) -> str:
        """Product and device."""
        return f"{self.product} camera" + (f" {self.device}" if self.device else "")
