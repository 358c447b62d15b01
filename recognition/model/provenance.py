"""Provenance of a model: the scan, the moment and the data from which it was made."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Provenance:
    """Where a model comes from. Values that are not known are None."""

    release: str | None = None
    """Release of Pointchain that made the model."""
    scan: str | None = None
    """Id of the scan in the service."""
    captured_at: str | None = None
    """Time of the last view, RFC 3339 in UTC. The model shows the scene at this moment."""
    recording_sha256: str | None = None
    """SHA-256 of the recording. A recording that contains its own model cannot contain this hash."""
    calibration_sha256: str | None = None
    """SHA-256 of the hand-eye calibration."""
    simulated: bool | None = None
    """Whether the arm or the camera was simulated."""
    intensity_views: int | None = None
    """Number of views that have an intensity image."""
