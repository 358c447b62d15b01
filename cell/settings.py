"""What a cell is made of and how it may move: values only. `service.config` reads them from a file.

The models are pydantic's, so that a mistyped key or an impossible value is refused with its name.
"""

import ipaddress
import math
import re
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import BaseModel, ConfigDict, Discriminator, Field, Tag, field_validator, model_validator

from recognition.parameters import R_MAX, R_MIN

ArmModelName = Literal["ur3e", "ur5e", "ur10e"]
CameraName = Literal["oak-d-sr", "oak-d-pro", "ideal"]
OakProduct = Literal["oak-d", "oak-d-pro", "oak-d-sr", "oak4-d"]
Range = tuple[float, float]
Vector3 = tuple[float, float, float]
Vector6 = tuple[float, float, float, float, float, float]


MOST_M = 5.0
"""Nothing of a cell is farther from the arm's base."""

BASE_RADIUS_M: dict[ArmModelName, float] = {"ur3e": 0.064, "ur5e": 0.075, "ur10e": 0.095}
"""Of the arm's base about its axis, by the maker's drawings: half the width of its foot."""


def _is_loopback(address: str) -> bool:
    try:
        return ipaddress.IPv4Address(address).is_loopback
    except ValueError:
        return False


class _Settings(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class ArmSettings(_Settings):
    """What holds for any arm."""

    model: ArmModelName = "ur5e"
    speed_rad_s: float = Field(default=1.0, gt=0, le=3.14)
    """Speed of the fastest joint of a move; ur_rtde takes no greater one."""
    acceleration_rad_s2: float = Field(default=1.4, gt=0, le=14.0)
    flange_speed_m_s: float = Field(default=0.25, gt=0, le=2.0)
    """The flange never goes faster; moves are slowed down to keep it."""
    stop_deceleration_m_s2: float = Field(default=4.0, ge=1.0, le=15.0)
    """Of the flange, after a stop."""
    watchdog_hz: float = Field(default=2.5, ge=1.0, le=50.0)
    """The controller stops the arm by itself when it hears nothing of us for 1 / this, seconds."""
    home_q_rad: Vector6 | None = None
    """Joint angles at which a scan ends; found by the planner unless given."""

    @field_validator("home_q_rad")
    @classmethod
    def _turns(cls, value: Vector6 | None) -> Vector6 | None:
        if value is not None and max(map(abs, value)) > 2 * math.pi:
            raise ValueError("a joint turns from -2 pi to 2 pi; angles are radians, not degrees")
        return value


class SimulatedArm(ArmSettings):
    """Our virtual UR controller, in a process of its own on this machine."""

    kind: Literal["simulated"] = "simulated"
    host: str | None = None
    """Loopback address that it listens on; the first free one from 127.0.0.2 on unless given."""
    time_factor: float = Field(default=1.0, ge=0.1, le=100.0)
    """The simulated arm moves so many times as fast."""

    @field_validator("host")
    @classmethod
    def _loopback(cls, value: str | None) -> str | None:
        # ur_rtde leaves out its check for remote control on 127.0.0.1: nothing is simulated there.
        if value is not None and not (_is_loopback(value) and value != "127.0.0.1"):
            raise ValueError('a simulated arm listens on 127.0.0.2 or above; a real one needs kind = "ur"')
        return value


class URArm(ArmSettings):
    """A UR e-Series robot, or URSim."""

    kind: Literal["ur"]
    host: str
    """The controller's address."""

    @field_validator("host")
    @classmethod
    def _address(cls, value: str) -> str:
        if not re.fullmatch(r"[0-9A-Za-z]([0-9A-Za-z._-]*[0-9A-Za-z])?", value):
            raise ValueError('the controller\'s IP address or name alone is needed, as "192.168.1.10"')
        return value


class CameraSettings(_Settings):
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


class WorkspaceSettings(_Settings):
    """Where the strings lie, in the robot's base frame."""

    x_m: Range = (0.18, 0.54)
    y_m: Range = (-0.18, 0.18)
    top_m: float = Field(default=0.12, gt=0, le=2.0)
    """Height of the workspace above the table."""

    @field_validator("x_m", "y_m")
    @classmethod
    def _ordered(cls, value: Range) -> Range:
        if not value[0] < value[1]:
            raise ValueError("the first must be less than the second, as [0.2, 0.7]")
        if max(map(abs, value)) > MOST_M:
            raise ValueError("metres are needed; no arm reaches that far")
        return value


class MountingSettings(_Settings):
    """How arm and table stand to one another. The base frame's z must point up."""

    table_z_m: float = Field(default=0.0, ge=-3.0, le=3.0)
    """Height of the table in the base frame: negative where the arm stands on a pedestal."""
    clearance_m: float = Field(default=0.03, ge=0.0, le=0.5)
    """Least distance of arm and camera from the table, and of the arm's parts from one another."""
    obstacles_m: tuple[tuple[Vector3, Vector3], ...] = ()
    """Boxes that the arm must not touch, each by two opposite corners, base frame."""

    @field_validator("obstacles_m")
    @classmethod
    def _boxes(cls, value: tuple[tuple[Vector3, Vector3], ...]) -> tuple[tuple[Vector3, Vector3], ...]:
        for number, (one, other) in enumerate(value, 1):
            if max(map(abs, one + other)) > MOST_M:
                raise ValueError(f"box {number} is farther off than {MOST_M:g} m; metres are needed")
            if any(a == b for a, b in zip(one, other, strict=True)):
                raise ValueError(f"box {number} is flat: its two corners must differ in x, y and z")
        return value


class ScanSettings(_Settings):
    """How a live scan goes."""

    views: int = Field(default=8, ge=2, le=32)
    min_views: int = Field(default=4, ge=2, le=32)
    """With fewer, a scan is refused or fails."""
    string_radius_m: float | None = Field(default=None, ge=R_MIN, le=R_MAX)
    """Of the strings that this cell sees; measured in each scan unless given."""

    @model_validator(mode="after")
    def _possible(self) -> Self:
        if self.min_views > self.views:
            raise ValueError(f"min_views is {self.min_views}, more than the {self.views} views")
        return self


class HandEyeSettings(_Settings):
    """The hand-eye calibration."""

    file: Path | None = None
    """JSON file of the calibration in use, with T_flange_camera; `hand_eye.json` in `folder` unless given."""
    max_age_days: float = Field(default=90.0, gt=0)
    """An older one is refused."""
    folder: Path | None = None
    """Where the calibrations made by this cell are kept."""
    rough_xyz_m: Vector3 | None = None
    """Where the camera is on the flange, measured with a ruler: its first calibration needs to know it, to 3 cm. Where
    told, no calibration is begun from one in use that differs by more."""
    rough_rotation_rad: Vector3 = (0.0, 0.0, 0.0)
    """How it is turned: the rotation vector from the flange's axes to the camera's (x right, y down, z forward), to 10
    degrees."""

    @property
    def active_file(self) -> Path | None:
        """Where the calibration in use is, if there is one; None where no place for it is known."""
        return self.file or (None if self.folder is None else self.folder / "hand_eye.json")

    @field_validator("file", "folder")
    @classmethod
    def _absolute(cls, value: Path | None) -> Path | None:
        return None if value is None else value.expanduser().absolute()

    @field_validator("rough_xyz_m")
    @classmethod
    def _near(cls, value: Vector3 | None) -> Vector3 | None:
        if value is not None and math.hypot(*value) > 1.0:
            raise ValueError("no camera is more than 1 m from the flange that carries it; metres are needed")
        return value

    @field_validator("rough_rotation_rad")
    @classmethod
    def _turned(cls, value: Vector3) -> Vector3:
        if math.hypot(*value) > 2 * math.pi:
            raise ValueError("a rotation vector is no longer than 2 pi; its length is an angle in radians, not degrees")
        return value


def _kind(value: object) -> object:
    """Simulated, unless told otherwise."""
    return value.get("kind", "simulated") if isinstance(value, dict) else getattr(value, "kind", None)


AnyArm = Annotated[
    Annotated[SimulatedArm, Tag("simulated")] | Annotated[URArm, Tag("ur")],
    Discriminator(_kind, custom_error_type="kind", custom_error_message='kind must be "simulated" or "ur"'),
]
AnyCamera = Annotated[
    Annotated[SimulatedCamera, Tag("simulated")] | Annotated[OakCamera, Tag("oak")],
    Discriminator(_kind, custom_error_type="kind", custom_error_message='kind must be "simulated" or "oak"'),
]


class CellSettings(_Settings):
    """The whole cell. Unless told otherwise it is a simulated one."""

    arm: AnyArm = SimulatedArm()
    camera: AnyCamera = SimulatedCamera()
    hand_eye: HandEyeSettings = HandEyeSettings()
    workspace: WorkspaceSettings = WorkspaceSettings()
    mounting: MountingSettings = MountingSettings()
    scan: ScanSettings = ScanSettings()

    @model_validator(mode="after")
    def _possible(self) -> Self:
        if isinstance(self.camera, SimulatedCamera) and not isinstance(self.arm, SimulatedArm):
            raise ValueError("camera.kind is simulated, arm.kind is not: a simulated camera needs the simulated arm")
        self._refuse_base_within()
        return self

    def _refuse_base_within(self) -> None:
        """No string lies where the arm stands. Below its base there is room when it hangs above the table."""
        x_m, y_m, (_, top) = self.workspace_m
        radius = BASE_RADIUS_M[self.arm.model]
        aside = math.hypot(*(max(low, 0.0, -high) for low, high in (x_m, y_m)))
        if aside < radius and top > 0:
            raise ValueError(
                f"workspace: x_m {list(x_m)} and y_m {list(y_m)} hold the arm's own base, which stands about x = y = 0 "
                f"with a radius of {radius:g} m, from z = 0 up: choose x_m or y_m beside it; where the base is above "
                "the table, mounting.table_z_m says how far, and workspace.top_m must end below it"
            )

    @property
    def workspace_m(self) -> tuple[Range, Range, Range]:
        """The box in the base frame."""
        floor = self.mounting.table_z_m
        return self.workspace.x_m, self.workspace.y_m, (floor, floor + self.workspace.top_m)
