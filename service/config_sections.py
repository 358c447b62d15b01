"""The sections of the configuration that are the service's own; those of the cell are in `cell.settings`."""

from typing import Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

from recognition.gripper import Gripper


class LimitsConfig(BaseModel):
    """What one request or one scan may use."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    upload_bytes: int = Field(default=512 * 2**20, gt=0)
    """Largest recording that is taken, bytes."""
    request_bytes: int = Field(default=64 * 2**10, gt=0)
    """Largest body of any other request, bytes."""
    recognition_s: float = Field(default=120.0, gt=0, allow_inf_nan=False)
    """Recognition of one scan is stopped after so many seconds."""
    event_streams: int = Field(default=32, ge=1, le=1000)
    """So many clients may follow events at a time ..."""
    event_streams_each: int = Field(default=4, ge=1, le=1000)
    """... and so many with one token."""
    min_free_bytes: int = Field(default=256 * 2**20, ge=0)
    """With less free space in the data folder nothing is begun that would take more of it, bytes. A scan takes about
    10 MB; the database needs room to tell how it ended."""


class SecurityConfig(BaseModel):
    """Who may speak to the service."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    allowed_hosts: tuple[str, ...] = ()
    """Names and addresses by which the service may be called, besides loopback's and `host`."""


class RetentionConfig(BaseModel):
    """When old scans and recordings are removed: never unless set, and never to make room."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    max_age_days: float | None = Field(default=None, gt=0, allow_inf_nan=False)
    """Older ones are removed; None: none is for its age."""
    max_bytes: int | None = Field(default=None, gt=0)
    """The oldest are removed as long as all together have more bytes; None: none is for its size."""


class LogConfig(BaseModel):
    """How the log is written, to stderr."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    format: Literal["auto", "json", "text"] = "auto"
    """`auto`: for people on a terminal, one JSON document a line elsewhere."""
    level: Literal["debug", "info", "warning", "error"] = "info"


class GripperConfig(BaseModel):
    """The gripper that grasps are found for; each key as in `recognition.gripper.Gripper`, metres."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    finger_width_m: float = Gripper.finger_width_m
    finger_thickness_m: float = Gripper.finger_thickness_m
    finger_depth_m: float = Gripper.finger_depth_m
    stroke_m: float = Gripper.stroke_m
    palm_width_m: float = Gripper.palm_width_m
    opening_margin_m: float = Gripper.opening_margin_m
    clearance_m: float = Gripper.clearance_m
    table_clearance_m: float = Gripper.table_clearance_m

    @property
    def value(self) -> Gripper:
        """What recognition takes."""
        return Gripper(**self.model_dump())

    @model_validator(mode="after")
    def _possible(self) -> "GripperConfig":
        # Gripper's own conditions; its error is a ValueError, and names the key.
        _ = self.value
        return self
