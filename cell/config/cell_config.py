"""Settings of a cell: devices, workspace, mounting, calibration and scan. `service.config` reads them from a file.

A mistyped key or an impossible value is rejected with its name.
"""

import math
from pathlib import Path
from typing import Annotated, Self

from pydantic import BeforeValidator, Discriminator, Field, Tag, WithJsonSchema, field_validator, model_validator

from cell.config.arm_config import SimulatedArm, URArm
from cell.config.arm_models import BASE_RADIUS_M
from cell.config.camera_config import OakCamera, SimulatedCamera
from cell.config.gripper_config import GripperSettings
from cell.config.scan_views import MAX_VIEWPOINTS, MIN_VIEWPOINTS, Views, count_viewpoints, parse_views
from cell.config.strict_model import Range, StrictSettings, Vector3
from recognition.parameters import R_MAX, R_MIN

MAX_DISTANCE_M = 5.0
"""Largest distance of any part of the cell from the arm's base."""


ScanViews = Annotated[
    Views,
    BeforeValidator(parse_views),
    WithJsonSchema(
        {
            "anyOf": [
                {"type": "integer", "minimum": MIN_VIEWPOINTS, "maximum": MAX_VIEWPOINTS},
                {"type": "string", "const": "auto"},
            ]
        }
    ),
]
"""Validated number of viewpoints, or `auto`."""


class WorkspaceSettings(StrictSettings):
    """The box in which the strings lie, in the base frame of the robot."""

    x_m: Range = (0.18, 0.54)
    """Limits of the box along the x axis of the base frame."""
    y_m: Range = (-0.18, 0.18)
    """Limits of the box along the y axis of the base frame."""
    top_m: float = Field(default=0.12, gt=0, le=2.0)
    """Height of the box above the table."""

    @field_validator("x_m", "y_m")
    @classmethod
    def _ordered(cls, value: Range) -> Range:
        if not value[0] < value[1]:
            raise ValueError("the first must be less than the second, as [0.2, 0.7]")
        if max(map(abs, value)) > MAX_DISTANCE_M:
            raise ValueError("metres are needed; no arm reaches that far")
        return value


class MountingSettings(StrictSettings):
    """Table, obstacles and clearance in the base frame of the robot, whose z axis must point up."""

    table_z_m: float = Field(default=0.0, ge=-3.0, le=3.0)
    """Height of the table in the base frame. It is negative where the arm stands on a pedestal."""
    clearance_m: float = Field(default=0.03, ge=0.0, le=0.5)
    """Minimum distance of arm, camera and gripper from table and obstacles, and of the links from one another."""
    obstacles_m: tuple[tuple[Vector3, Vector3], ...] = ()
    """Boxes that arm, camera and gripper must not touch, each given by two opposite corners in the base frame."""

    @field_validator("obstacles_m")
    @classmethod
    def _boxes(cls, value: tuple[tuple[Vector3, Vector3], ...]) -> tuple[tuple[Vector3, Vector3], ...]:
        for number, (one, other) in enumerate(value, 1):
            if max(map(abs, one + other)) > MAX_DISTANCE_M:
                raise ValueError(f"box {number} is farther off than {MAX_DISTANCE_M:g} m; metres are needed")
            if any(a == b for a, b in zip(one, other, strict=True)):
                raise ValueError(f"box {number} is flat: its two corners must differ in x, y and z")
        return value


class ScanSettings(StrictSettings):
    """Default parameters of a live scan."""

    views: ScanViews = 8
    """Number of viewpoints, or "auto": one ring of four viewpoints, and four more only if something is doubtful."""
    min_views: int = Field(default=4, ge=1, le=32)
    """Minimum number of views. With fewer reachable viewpoints the scan is refused; with fewer views it fails."""
    string_radius_m: float | None = Field(default=None, ge=R_MIN, le=R_MAX)
    """Radius of the strings in this cell. Without it, the radius is measured in each scan."""

    @model_validator(mode="after")
    def _possible(self) -> Self:
        if self.min_views > self.viewpoints:
            raise ValueError(f"min_views is {self.min_views}, more than the {self.viewpoints} views")
        return self

    @property
    def viewpoints(self) -> int:
        """Number of viewpoints to plan."""
        return count_viewpoints(self.views)


class HandEyeSettings(StrictSettings):
    """The hand-eye calibration: its file, its maximum age and the initial guess for the first one."""

    file: Path | None = None
    """File of the active calibration. The default is `hand_eye.json` in `folder`."""
    max_age_days: float = Field(default=90.0, gt=0)
    """Maximum age of the active calibration. An older one is refused."""
    folder: Path | None = None
    """Folder of the calibrations that this cell makes. The default is `calibration` in `data_dir`."""
    rough_xyz_m: Vector3 | None = None
    """Position of the camera in the flange frame, measured with a ruler to 3 cm. The first calibration needs it. While
    it is set, calibration runs are refused if the active calibration differs by more than 3 cm or 10 degrees."""
    rough_rotation_rad: Vector3 = (0.0, 0.0, 0.0)
    """Orientation of the camera in the flange frame as a rotation vector, to 10 degrees. Camera axes: x right, y down,
    z forward."""

    @property
    def active_file(self) -> Path | None:
        """Path of the active calibration, which may not exist yet, or None without a configured path."""
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
    """Return the kind of a device, which is simulated by default."""
    return value.get("kind", "simulated") if isinstance(value, dict) else getattr(value, "kind", None)


AnyArm = Annotated[
    Annotated[SimulatedArm, Tag("simulated")] | Annotated[URArm, Tag("ur")],
    Discriminator(_kind, custom_error_type="kind", custom_error_message='kind must be "simulated" or "ur"'),
]
AnyCamera = Annotated[
    Annotated[SimulatedCamera, Tag("simulated")] | Annotated[OakCamera, Tag("oak")],
    Discriminator(_kind, custom_error_type="kind", custom_error_message='kind must be "simulated" or "oak"'),
]


class CellSettings(StrictSettings):
    """Settings of the whole cell. The default is a simulated cell."""

    arm: AnyArm = SimulatedArm()
    camera: AnyCamera = SimulatedCamera()
    hand_eye: HandEyeSettings = HandEyeSettings()
    workspace: WorkspaceSettings = WorkspaceSettings()
    mounting: MountingSettings = MountingSettings()
    scan: ScanSettings = ScanSettings()
    gripper: GripperSettings = GripperSettings()

    @model_validator(mode="after")
    def _possible(self) -> Self:
        # a forgotten camera must not become a simulated one, whose strings do not exist
        if not isinstance(self.arm, SimulatedArm) and "kind" not in self.camera.model_fields_set:
            raise ValueError(
                f'arm.kind is "{self.arm.kind}", and camera.kind is missing: set it to "oak", or to "simulated" for a '
                "rehearsal with UR's simulator"
            )
        self._refuse_base_within()
        return self

    def _refuse_base_within(self) -> None:
        """Raise ValueError if the workspace contains the base of the arm. Strings may lie below a base that hangs."""
        x_m, y_m, (_, top) = self.workspace_m
        radius = BASE_RADIUS_M[self.arm.model]
        aside = math.hypot(*(max(low, 0.0, -high) for low, high in (x_m, y_m)))
        if aside < radius and top > 0:
            raise ValueError(
                f"workspace: x_m {list(x_m)} and y_m {list(y_m)} contain the base of the arm, which stands at x = "
                f"y = 0 with a radius of {radius:g} m, from z = 0 up: choose x_m or y_m beside it; where the base is "
                "above the table, set its height in mounting.table_z_m and end workspace.top_m below it"
            )

    @property
    def simulated(self) -> bool:
        """Whether the arm or the camera is simulated. What such a cell recognises is not on a real table."""
        return isinstance(self.arm, SimulatedArm) or isinstance(self.camera, SimulatedCamera)

    @property
    def workspace_m(self) -> tuple[Range, Range, Range]:
        """The box in the base frame."""
        floor = self.mounting.table_z_m
        return self.workspace.x_m, self.workspace.y_m, (floor, floor + self.workspace.top_m)

    @property
    def camera_id(self) -> str | None:
        """Device id of the camera, or None if the settings do not determine it."""
        return self.camera.device_id

    @property
    def robot_serial(self) -> str | None:
        """Serial number of the robot, or None if the settings do not determine it."""
        return self.arm.serial

    def for_views(self, views: Views | None) -> "CellSettings":
        """Return the settings of a scan with these views. None means the configured ones."""
        if views is None:
            return self
        least = min(count_viewpoints(views), self.scan.min_views)
        return self.model_copy(update={"scan": self.scan.model_copy(update={"views": views, "min_views": least})})
