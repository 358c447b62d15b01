"""JSON document of a viewpoint plan, as `ViewpointPlan.to_json` writes it. Metres, radians, seconds."""

from pydantic import Field

from service.api.schemas.base import ApiModel

Matrix = list[list[float]]


class PlannedViewpoint(ApiModel):
    """A planned pose of the camera."""

    index: int
    azimuth_rad: float
    elevation_rad: float
    distance_m: float
    roll_rad: float
    T_base_camera: Matrix
    T_base_flange: Matrix
    q_rad: list[float] | None
    """Joint angles of the arm at the viewpoint. Null if it cannot be reached."""
    reason: str | None
    """Why the viewpoint cannot be reached."""
    fallback: str | None
    """The relaxation of the viewpoint that made it reachable."""


class PlanLeg(ApiModel):
    """The path to a viewpoint, or home."""

    view: int | None
    """Index of the viewpoint. Null means home."""
    waypoints_rad: Matrix
    """Joint angles at each waypoint, in order."""
    travel_rad: float


class PlanCoverage(ApiModel):
    """Coverage of the workspace by the images."""

    fraction: float = Field(ge=0, le=1)
    warning: str | None
    """The part of the workspace that the images do not show well, if any."""


class PlanDocument(ApiModel):
    """All viewpoints, and the path through the reachable ones."""

    reachable: int
    viewpoints: list[PlannedViewpoint]
    """In the order of their indices."""
    legs: list[PlanLeg]
    """In the order of execution. The last leg leads home."""
    start_q_rad: list[float]
    """Joint angles at the start of the first leg. Home, unless the pose of the arm was known."""
    home_q_rad: list[float]
    travel_rad: float
    coverage: PlanCoverage
    planning_s: float
    held_out: list[int]
    """Indices of the viewpoints whose images verify a calibration."""
    warnings: list[str]
    """Messages for the operator about a plan that can still be executed."""
