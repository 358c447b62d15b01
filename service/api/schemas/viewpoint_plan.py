"""A plan of viewpoints as it goes over HTTP: what `ViewpointPlan.to_json` writes. Metres, radians, seconds."""

from pydantic import Field

from service.api.schemas.base import Described

Matrix = list[list[float]]


class PlannedViewpoint(Described):
    """A place from which the camera would look."""

    index: int
    azimuth_rad: float
    elevation_rad: float
    distance_m: float
    roll_rad: float
    T_base_camera: Matrix
    T_base_flange: Matrix
    q_rad: list[float] | None
    """The arm's joints there; null: it cannot be reached."""
    reason: str | None
    """Why not."""
    fallback: str | None
    """What was given way in for it to be reached."""


class Leg(Described):
    """The way to a viewpoint, or home."""

    view: int | None
    """Null: home."""
    waypoints_rad: Matrix
    """Joints one after the other."""
    travel_rad: float


class PlanCoverage(Described):
    """Of the workspace, by the pictures."""

    share: float = Field(ge=0, le=1)
    warning: str | None
    """What part of the workspace they do not show well, if any."""


class PlanDocument(Described):
    """All viewpoints, and the way through those that can be reached."""

    reached: int
    viewpoints: list[PlannedViewpoint]
    """By index."""
    legs: list[Leg]
    """In the order of execution; the last leads home."""
    start_q_rad: list[float]
    """Where the first leg begins; home unless the arm's place was known."""
    home_q_rad: list[float]
    travel_rad: float
    coverage: PlanCoverage
    planning_s: float
    held_out: list[int]
    """Of a calibration: viewpoints whose pictures judge it."""
    warnings: list[str]
    """What an operator should know of a plan that can be carried out all the same."""
