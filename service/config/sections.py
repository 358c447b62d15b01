"""Configuration sections of the service. The sections of the cell are in `cell.config.cell_config`."""

from typing import Literal

from pydantic import BaseModel, ConfigDict, Field


class LimitsConfig(BaseModel):
    """Limits of requests, recognition, event streams and disk space."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    upload_bytes: int = Field(default=512 * 2**20, gt=0)
    """Largest recording that an upload may have."""
    request_bytes: int = Field(default=64 * 2**10, gt=0)
    """Largest body of any other request."""
    recognition_s: float = Field(default=120.0, gt=0, allow_inf_nan=False)
    """Timeout of the recognition of one scan."""
    event_streams: int = Field(default=32, ge=1, le=1000)
    """Maximum number of open event streams."""
    event_streams_each: int = Field(default=4, ge=1, le=1000)
    """Maximum number of open event streams per token."""
    min_free_bytes: int = Field(default=256 * 2**20, ge=0)
    """Minimum free space in the data folder. With less, the service refuses scans, uploads and calibrations. One scan
    takes about 10 MB."""


class SecurityConfig(BaseModel):
    """Names by which clients may address the service."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    allowed_hosts: tuple[str, ...] = ()
    """Host names and addresses that the service accepts in the header `Host`, in addition to the loopback names and
    `host`."""


class RetentionConfig(BaseModel):
    """Removal of old scans and recordings. Without a setting, nothing is removed."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    max_age_days: float | None = Field(default=None, gt=0, allow_inf_nan=False)
    """Scans and recordings older than this are removed."""
    max_bytes: int | None = Field(default=None, gt=0)
    """The oldest scans and recordings are removed while all recordings and results together exceed this size."""


class LogConfig(BaseModel):
    """The log, which goes to stderr."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    format: Literal["auto", "json", "text"] = "auto"
    """`text`: lines for people. `json`: one JSON document per line. `auto`: text on a terminal, JSON elsewhere."""
    level: Literal["debug", "info", "warning", "error"] = "info"
    """Lowest level that is logged. `debug` includes requests to `/healthz`, `/readyz` and `/metrics`."""
