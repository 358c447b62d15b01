"""JSON documents of the cell."""

import math
import time
from dataclasses import replace
from typing import Literal

from pydantic import Field

from cell.config.cell_config import CellSettings
from cell.control.status import CellStatus, State
from cell.devices import RobotMode, SafetyMode
from cell.errors import RobotLostError
from cell.planning.viewpoints import ViewpointPlan
from service.api.schemas.base import ApiModel, RequestModel
from service.api.schemas.calibration import CellWarning
from service.api.schemas.scans import ViewChoice
from service.jobs.interventions import Intervention, Interventions

Matrix = list[list[float]]
MAX_STATE_AGE_S = 3.0
"""Age above which the reported modes are unknown, because after a fault the robot is not read any more.

The state of an idle arm is read twice a second.
"""


class RobotResource(ApiModel):
    """The last state that the controller of the arm reported.

    The modes and `moving` are null, because they are unknown, while the cell is not ready, when the connection to the
    robot is lost, and when the state is older than 3 s. In a fault, `moving` is null too.
    """

    kind: Literal["simulated", "ur"]
    model: str
    serial: str | None
    """Null until the arm was connected."""
    software: str | None
    robot_mode: RobotMode | None
    safety_mode: SafetyMode | None
    moving: bool | None
    q_rad: list[float] | None
    T_base_flange: Matrix | None
    at_home: bool | None
    """Whether the arm stood in its home posture when its state was last read. Null until viewpoints were planned. After
    a release, another program may have moved the arm since."""
    age_s: float | None
    """Age of the state, seconds."""


class CameraResource(ApiModel):
    """The camera, as it last reported."""

    kind: Literal["simulated", "oak"]
    product: str | None
    """Null until the camera was connected."""
    device_id: str | None
    width: int | None
    height: int | None
    connection: str | None
    temperature_c: float | None
    warnings: list[str]


class CalibrationSummary(ApiModel):
    """The hand-eye calibration in use."""

    T_flange_camera: Matrix
    created_at: str | None
    """Time of the measurement, RFC 3339. Null if it is not known."""
    camera_id: str | None
    robot_serial: str | None
    sha256: str
    warnings: list[str]


class UnreachableViewpoint(ApiModel):
    """A viewpoint that the arm cannot reach."""

    index: int
    reason: str


class ViewpointsResource(ApiModel):
    """Summary of the last plan. `POST /api/viewpoints/plan` returns a full plan."""

    planned: int
    reachable: int
    unreachable: list[UnreachableViewpoint]
    warning: str | None
    """The part of the workspace that the reachable viewpoints do not show well, if any."""


class InterventionResource(ApiModel):
    """A stop of the arm, or the acknowledgement of a fault."""

    at: str
    """Time, RFC 3339."""
    by: str | None
    """Name of the caller. Null if it needs no token, and for a stop by the service itself."""


class CellResource(ApiModel):
    """The last known state of the cell. Reading it contacts no device."""

    state: State
    """In `not_ready`, connect or start a live scan. In `fault`, a person must inspect the cell and acknowledge."""
    problem: str | None = Field(examples=["urn:pointchain:protective-stop"])
    """Type of the problem that keeps the cell from being ready, for programs."""
    reason: str | None
    """The same as a message for people, with what to do."""
    simulated: bool
    """Whether the arm or the camera is simulated."""
    robot: RobotResource
    camera: CameraResource
    calibration: CalibrationSummary | None
    """Null until a calibration was loaded."""
    viewpoints: ViewpointsResource | None
    """Null until viewpoints were planned."""
    warnings: list[CellWarning]
    """Conditions that need attention, for example a drift of the camera from its calibration."""
    last_stop: InterventionResource | None
    """The last stop of the arm since the service started."""
    last_acknowledgement: InterventionResource | None
    """The last acknowledgement of a fault since the service started."""


def viewpoints_resource(plan: ViewpointPlan) -> ViewpointsResource:
    """Return the summary of a plan."""
    return ViewpointsResource(
        planned=len(plan.viewpoints),
        reachable=plan.reachable,
        unreachable=[
            UnreachableViewpoint(index=viewpoint.index, reason=viewpoint.reason)
            for viewpoint in plan.viewpoints
            if viewpoint.reason is not None
        ],
        warning=plan.unseen,
    )


class PlanRequest(RequestModel):
    """Number of viewpoints to plan. Null means as configured."""

    views: ViewChoice | None = None


def cell_resource(
    status: CellStatus,
    settings: CellSettings,
    using_arm: str | None,
    warnings: list[CellWarning],
    interventions: Interventions,
) -> CellResource:
    """Return the cell as a document.

    Args:
        status: The last known status.
        settings: Settings of the cell.
        using_arm: Description of the accepted scan or calibration that has not ended. None if there is none.
        warnings: Conditions that need attention.
        interventions: The last stop and the last acknowledgement.
    """
    if status.state == "ready" and using_arm is not None:
        status = replace(status, state="busy", slug="cell-busy", reason=f"{using_arm} is under way")
    arm, state, camera, hand_eye, plan = status.arm, status.arm_state, status.camera, status.hand_eye, status.plan
    age_s = math.inf if state is None else state.age_s + time.monotonic() - state.read_s
    is_unknown = status.state == "not_ready" or status.slug == RobotLostError.slug or age_s > MAX_STATE_AGE_S
    current_state = None if is_unknown else state
    return CellResource(
        state=status.state,
        problem=None if status.slug is None else f"urn:pointchain:{status.slug}",
        reason=status.reason,
        simulated=settings.simulated,
        robot=RobotResource(
            kind=settings.arm.kind,
            model=settings.arm.model,
            serial=None if arm is None else arm.serial,
            software=None if arm is None else arm.software,
            robot_mode=None if current_state is None else current_state.robot_mode,
            safety_mode=None if current_state is None else current_state.safety_mode,
            moving=None if current_state is None or status.state == "fault" else current_state.moving,
            q_rad=None if state is None else state.q_rad.tolist(),
            T_base_flange=None if state is None else state.T_base_flange.tolist(),
            at_home=None if state is None or plan is None else plan.is_home(state.q_rad),
            age_s=None if state is None else age_s,
        ),
        camera=CameraResource(
            kind=settings.camera.kind,
            product=None if camera is None else camera.product,
            device_id=None if camera is None else camera.device_id,
            width=None if camera is None else camera.width,
            height=None if camera is None else camera.height,
            connection=None if camera is None else camera.connection,
            temperature_c=None if camera is None else camera.temperature_c,
            warnings=[] if camera is None else list(camera.warnings),
        ),
        calibration=None
        if hand_eye is None
        else CalibrationSummary(
            T_flange_camera=hand_eye.T_flange_camera.tolist(),
            created_at=None if hand_eye.created is None else hand_eye.created.isoformat(),
            camera_id=hand_eye.camera_id,
            robot_serial=hand_eye.robot_serial,
            sha256=hand_eye.sha256,
            warnings=list(hand_eye.warnings),
        ),
        viewpoints=None if plan is None else viewpoints_resource(plan),
        warnings=warnings,
        last_stop=_intervention_resource(interventions.stop),
        last_acknowledgement=_intervention_resource(interventions.acknowledgement),
    )


def _intervention_resource(intervention: Intervention | None) -> InterventionResource | None:
    return None if intervention is None else InterventionResource(at=intervention.at, by=intervention.by)
