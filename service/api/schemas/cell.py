"""What goes over HTTP about the cell, as JSON."""

import math
import time
from dataclasses import replace
from typing import Annotated, Literal

from pydantic import Field

from cell.config.cell_config import CellSettings
from cell.control.status import CellStatus, State
from cell.devices import RobotMode, SafetyMode
from service.api.schemas.base import Described
from service.api.schemas.calibration import CellWarning
from service.api.schemas.scans import WHOLE

Matrix = list[list[float]]
HEARD_S = 3.0
"""What was heard longer ago says nothing of how the robot is now: behind a fault nobody listens to it. An idle arm is
looked at twice a second."""


class RobotResource(Described):
    """The arm, as its controller last told it. Its modes are null while the cell is not ready or the last is older than
    3 s, and `moving` in a fault too: nobody knows them."""

    kind: Literal["simulated", "ur"]
    model: str
    serial: str | None
    """Null until it was connected."""
    software: str | None
    robot_mode: RobotMode | None
    safety_mode: SafetyMode | None
    moving: bool | None
    q_rad: list[float] | None
    T_base_flange: Matrix | None
    age_s: float | None
    """How old that is."""


class CameraResource(Described):
    """The camera, as it last told."""

    kind: Literal["simulated", "oak"]
    product: str | None
    """Null until it was connected."""
    device_id: str | None
    width: int | None
    height: int | None
    connection: str | None
    temperature_c: float | None
    warnings: list[str]


class CalibrationResource(Described):
    """The hand-eye calibration in use."""

    T_flange_camera: Matrix
    created_at: str | None
    """When it was measured, RFC 3339; null: not known."""
    camera_id: str | None
    robot_serial: str | None
    sha256: str
    warnings: list[str]


class MissingViewpoint(Described):
    """A viewpoint that the arm cannot take."""

    index: int
    reason: str


class ViewpointsResource(Described):
    """The last plan in short; `POST /api/viewpoints/plan` has it whole."""

    planned: int
    reachable: int
    missing: list[MissingViewpoint]
    warning: str | None
    """What part of the workspace the reachable ones do not show well, if any."""


class CellResource(Described):
    """The cell as last seen: asking for it asks no device anything."""

    state: State
    """`not_ready`: connect, or start a live scan; `fault`: a person must look and acknowledge."""
    problem: str | None = Field(examples=["urn:pointchain:protective-stop"])
    """What keeps it from being ready, for programs."""
    reason: str | None
    """The same for people, and what to do."""
    robot: RobotResource
    camera: CameraResource
    calibration: CalibrationResource | None
    """Null until one was loaded."""
    viewpoints: ViewpointsResource | None
    """Null until there was a plan."""
    warnings: list[CellWarning]
    """What should be seen to, as a calibration from which the camera has drifted."""


class PlanRequest(Described):
    """How many viewpoints to plan; null takes the cell's number."""

    views: Annotated[int, Field(ge=2, le=32), WHOLE] | None = None


def cell_resource(
    status: CellStatus, settings: CellSettings, using_arm: str | None, warnings: list[CellWarning]
) -> CellResource:
    """The status as JSON. `using_arm`: the scan or calibration that is accepted and has not ended, in words."""
    if status.state == "ready" and using_arm is not None:
        status = replace(status, state="busy", slug="cell-busy", reason=f"{using_arm} is under way")
    arm, state, camera, hand_eye, plan = status.arm, status.arm_state, status.camera, status.hand_eye, status.plan
    age_s = math.inf if state is None else state.age_s + time.monotonic() - state.read_s
    known = None if status.state == "not_ready" or age_s > HEARD_S else state
    return CellResource(
        state=status.state,
        problem=None if status.slug is None else f"urn:pointchain:{status.slug}",
        reason=status.reason,
        robot=RobotResource(
            kind=settings.arm.kind,
            model=settings.arm.model,
            serial=None if arm is None else arm.serial,
            software=None if arm is None else arm.software,
            robot_mode=None if known is None else known.robot_mode,
            safety_mode=None if known is None else known.safety_mode,
            moving=None if known is None or status.state == "fault" else known.moving,
            q_rad=None if state is None else state.q_rad.tolist(),
            T_base_flange=None if state is None else state.T_base_flange.tolist(),
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
        else CalibrationResource(
            T_flange_camera=hand_eye.T_flange_camera.tolist(),
            created_at=None if hand_eye.created is None else hand_eye.created.isoformat(),
            camera_id=hand_eye.camera_id,
            robot_serial=hand_eye.robot_serial,
            sha256=hand_eye.sha256,
            warnings=list(hand_eye.warnings),
        ),
        viewpoints=None
        if plan is None
        else ViewpointsResource(
            planned=len(plan.viewpoints),
            reachable=sum(viewpoint.reason is None for viewpoint in plan.viewpoints),
            missing=[
                MissingViewpoint(index=viewpoint.index, reason=viewpoint.reason)
                for viewpoint in plan.viewpoints
                if viewpoint.reason is not None
            ],
            warning=plan.unseen,
        ),
        warnings=warnings,
    )
