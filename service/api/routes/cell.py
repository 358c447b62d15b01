"""Routes of the cell: state, geometry, connect, stop, release, acknowledge, and the plan of its viewpoints."""

from dataclasses import dataclass, replace
from typing import Any

from anyio import to_thread
from fastapi import APIRouter, Request, Response

from calibration.storage.hand_eye_file import HandEye
from service.api.dependencies import Context, Service, ViewCount
from service.api.problem_responses import CELL, problem_responses
from service.api.response_cache import json_response
from service.api.routes.recordings import BINARY
from service.api.schemas.calibration import CellWarning
from service.api.schemas.calibration_resources import calibration_warnings, recent_drift, usable_hand_eye
from service.api.schemas.cell import CellResource, PlanRequest, cell_resource
from service.api.schemas.cell_geometry import CellGeometry, cell_geometry
from service.api.schemas.viewpoint_plan import PlanDocument
from service.logs.request_time import arrival_time
from service.security.auth.caller import caller_of

router = APIRouter(prefix="/api", tags=["cell"])


@router.get("/cell", response_model=CellResource, responses=problem_responses())
async def get_cell(service: Service) -> Response:
    """Return the last known state of the cell, with robot, camera, calibration and viewpoints."""
    in_use = await service.response_cache.get(
        ("calibration", service.jobs.drift.scans), lambda: _calibration_in_use(service)
    )
    return json_response(_resource(service, in_use))


@router.get("/cell/geometry", response_model=CellGeometry, responses=problem_responses())
async def get_geometry(service: Service) -> Response:
    """Return the constant geometry of the cell, for drawing it: workspace, table, obstacles and the shape of the arm.

    The answer also has the settings of scans, calibration age and gripper. No device is contacted.
    """

    def read() -> Response:
        return json_response(cell_geometry(service.config, usable_hand_eye(service.cell)))

    return await service.response_cache.respond("geometry", read)


@router.post("/cell/connect", responses=problem_responses(*CELL, "not-ready"))
def connect_cell(service: Service) -> CellResource:
    """Connect arm and camera, unless they are connected. Nothing moves."""
    service.cell.connect()
    return _current_resource(service)


@router.post("/cell/stop", responses=problem_responses())
async def stop_cell(request: Request, service: Service) -> CellResource:
    """Stop the arm at once, in any state. This is not an emergency stop.

    A running live scan or calibration is aborted; it ends a moment after the answer. An earlier request that does not
    move the arm yet is refused.
    """
    by = caller_of(request).token_name
    stopped = await to_thread.run_sync(service.jobs.stop_arm, by, limiter=service.stopping)
    request.state.stopped_scan = stopped  # for logs
    # without the database and the disk, because a locked or slow one must not delay the next stop
    warnings = calibration_warnings(None, service.jobs.drift.latest, service.store.calibrations)
    return _resource(service, _CalibrationInUse(None, warnings))


@router.post("/cell/release", responses=problem_responses(*CELL, "not-ready"))
def release_arm(service: Service) -> CellResource:
    """End the service's program on the robot, so that another program can move the arm, for example to grasp.

    Releasing moves nothing. If a scan is moving the arm, the release waits until the arm is home. It is refused with
    `stopped` if the arm is stopped meanwhile. After a stop, the arm is released where it stands. The next live scan or
    connect takes the arm again.
    """
    service.jobs.release_arm(arrival_time())
    return _current_resource(service)


_AGAIN = {
    "Retry-After": {
        "description": "Time to wait in seconds, for the problem `too-early`",
        "schema": {"type": "integer"},
    }
}
_ACKNOWLEDGE = problem_responses(*CELL, "no-fault", "not-ready", "too-early")
_ACKNOWLEDGE[409]["headers"] = _AGAIN


@router.post("/cell/acknowledge", responses=_ACKNOWLEDGE)
def acknowledge_fault(request: Request, service: Service) -> CellResource:
    """Confirm that a person has inspected the cell after a fault. This unlocks a protective stop. Nothing moves."""
    service.cell.acknowledge()
    service.jobs.interventions.record_acknowledgement(caller_of(request).token_name)
    return _current_resource(service)


@router.post(
    "/viewpoints/plan",
    response_model=PlanDocument,
    responses=problem_responses("calibration", "config", "invalid-request", "viewpoints-unreachable"),
)
async def plan_viewpoints(service: Service, body: PlanRequest | None = None) -> Any:
    """Plan the viewpoints: which can be reached or why not, their order, and the path. Nothing moves."""
    views = body.views if body else None
    return await to_thread.run_sync(lambda: service.cell.plan(views).to_json(), limiter=service.planning)


PNG: dict[int | str, dict[str, Any]] = {200: {"content": {"image/png": BINARY}}}


@router.get(
    "/viewpoints/plan.png",
    response_class=Response,
    responses=PNG | problem_responses("calibration", "config", "invalid-request", "viewpoints-unreachable"),
)
async def get_plan_image(service: Service, views: ViewCount = None) -> Response:
    """Return a drawing of the planned viewpoints."""

    def draw() -> bytes:
        from cell.planning.plan_plot import draw_plan

        return draw_plan(service.cell.plan(views), service.cell.settings)

    return Response(await to_thread.run_sync(draw, limiter=service.planning), media_type="image/png")


@dataclass(frozen=True)
class _CalibrationInUse:
    """The calibration in use, or None if it is not known, and its warnings."""

    hand_eye: HandEye | None
    warnings: list[CellWarning]


def _calibration_in_use(service: Context) -> _CalibrationInUse:
    """Read the calibration from its file, because another may have been activated since the cell was connected."""
    hand_eye = usable_hand_eye(service.cell)
    drift = None if hand_eye is None else recent_drift(hand_eye, service.jobs.drift)
    return _CalibrationInUse(hand_eye, calibration_warnings(hand_eye, drift, service.store.calibrations))


def _current_resource(service: Context) -> CellResource:
    return _resource(service, _calibration_in_use(service))


def _resource(service: Context, in_use: _CalibrationInUse) -> CellResource:
    """Return the cell without reading database or disk."""
    status = service.cell.status
    if in_use.hand_eye is not None:
        status = replace(status, hand_eye=in_use.hand_eye)
    jobs = service.jobs
    return cell_resource(status, service.cell.settings, jobs.using_arm, in_use.warnings, jobs.interventions)
