"""Which camera it is, and how it looks."""

from typing import Literal, Self

from pydantic import Field, field_validator, model_validator

from cell.strict_settings import Range, StrictSettings, Vector3
from recognition.parameters import R_MAX, R_MIN

CameraName = Literal["oak-d-sr", "oak-d-pro", "ideal"]
OakProduct = Literal["oak-d", "oak-d-pro", "oak-d-sr", "oak4-d"]


class CameraSettings(StrictSettings):
    """What holds for any camera."""

    exposures: int = Field(default=5, ge=1, le=25)
    """The depth of a view is the median of so many."""
    fps: float = Field(default=10.0, ge=1.0, le=60.0)
    settle_s: float = Field(default=0.1, ge=0.0, le=5.0)
    """After the arm is at rest, so long until the first exposure that counts."""
    working_m: Range | None = None
    """Distances (nearest, farthest) from which to look; the camera model's own unless given."""
    body_m: Vector3 = (0.10, 0.04, 0.04)
    """Size of the camera's body along its own x, y and z, for collisions."""

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


class SimulatedCamera(CameraSettings):
    """A simulated OAK camera that looks at a simulated string scene."""

    kind: Literal["simulated"] = "simulated"
    model: CameraName = "oak-d-pro"
    scene: str = "figure-eight"
    """As in `pointchain simulate`."""
    seed: int = Field(default=3, ge=0)
    """Of the scene and of everything random."""
    string_radius_m: float = Field(default=0.0042, ge=R_MIN, le=R_MAX)
    errors: float = Field(default=1.0, ge=0.0, le=100.0)
    """Of arm and calibration, times those of a good cell; 0 for a perfect one."""

    @field_validator("scene")
    @classmethod
    def _known(cls, value: str) -> str:
        from cell.simulation.scenes import SCENES  # brings scipy along

        if value not in SCENES:
            raise ValueError(f"there are the scenes {', '.join(SCENES)}")
        return value


class OakCamera(CameraSettings):
    """A Luxonis OAK depth camera."""

    kind: Literal["oak"]
    device: str | None = None
    """Device id or address; the only one there is unless given."""
    product: OakProduct = "oak-d-pro"
    """Which it is, as its viewpoints are planned; oak-d-pro also stands for OAK-D S2 and the PoE ones."""
    width: int = Field(default=640, ge=320, le=1280)
    height: int = Field(default=400, ge=200, le=800)
    extended_disparity: bool = False
    """Measures nearer things; not on every model."""
    exposure_us: int | None = Field(default=None, ge=1, le=33_000)
    """Of each image, microseconds; found by the camera, then locked, unless given."""
    iso: int = Field(default=400, ge=100, le=1600)
    """With `exposure_us`."""
    ir_dots: float = Field(default=0.0, ge=0.0, le=1.0)
    """Power of the dot projector, where there is one."""

    @model_validator(mode="after")
    def _exists(self) -> Self:
        if self.extended_disparity and self.product == "oak-d-sr":
            raise ValueError("extended_disparity is set, but an oak-d-sr has none")
        if self.height * 16 > self.width * 10:
            raise ValueError(f"there are no images of {self.width}x{self.height}; at most 10/16 as high as wide")
        return self
