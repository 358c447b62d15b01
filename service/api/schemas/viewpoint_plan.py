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
    """Motion of the leading joint, summed over the waypoints."""
    duration_s: float
    """Duration of the motion at full speed slider."""
    home_waypoints_rad: Matrix
    """Joint angles at each waypoint from the end of the leg home, if the scan ends there. Empty for the last leg."""
    home_duration_s: float
    """Duration of the motion along these waypoints."""


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
    """Motion of the leading joint, summed over all legs."""
    duration_s: float
    """Duration of the motion, summed over all legs. Each move needs about 0.1 s more to start and to come to rest."""
    first: list[int]
    """Indices of the viewpoints that are visited first, after which a scan may end. Empty if it visits all."""
    early_duration_s: float | None
    """Duration of the motion if the scan ends after these viewpoints, with the path home. Null if there are none."""
    coverage: PlanCoverage
    planning_s: float
    held_out: list[int]
    """Indices of the viewpoints whose images verify a calibration."""
    warnings: list[str]
    """Messages for the operator about a plan that can still be executed."""
