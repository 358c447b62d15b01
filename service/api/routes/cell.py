"""The cell: its state, connecting, stopping, acknowledging, and where it would look from."""

from dataclasses import dataclass, replace
from typing import Any

from anyio import to_thread
from fastapi import APIRouter, Request, Response

from calibration.storage.hand_eye_file import HandEye
from service.api.dependencies import Context, Service, ViewCount
from service.api.problem_responses import CELL, problem_responses
from service.api.response_cache import json_answer
from service.api.routes.recordings import BINARY
from service.api.schemas.calibration import CellWarning
from service.api.schemas.calibration_resources import calibration_warnings, recent_drift, usable_hand_eye
from service.api.schemas.cell import CellResource, PlanRequest, cell_resource
from service.api.schemas.cell_geometry import RoomResource, room_resource
from service.api.schemas.viewpoint_plan import PlanDocument
from service.logs.request_time import arrived_s

router = APIRouter(prefix="/api", tags=["cell"])


@router.get("/cell", response_model=CellResource, responses=problem_responses())
async def get_cell(service: Service) -> Response:
    """The cell as last seen: state, robot, camera, calibration, viewpoints."""
    in_use = await service.reading.known(("calibration", service.jobs.drift.scans), lambda: _in_use(service))
    return json_answer(_told(service, in_use))


@router.get("/cell/room", response_model=RoomResource, responses=problem_responses())
async def get_room(service: Service) -> Response:
    """What of the cell stays as it is while the service runs, for whoever draws it: workspace, table, obstacles, the
    arm's shape, what is set. Asks no device anything."""

    def read() -> Response:
        return json_answer(room_resource(service.config, usable_hand_eye(service.cell)))

    return await service.reading.answer("room", read)


@router.post("/cell/connect", responses=problem_responses(*CELL, "not-ready"))
def connect_cell(service: Service) -> CellResource:
    """Connects arm and camera, unless they are. Nothing moves."""
    service.cell.connect()
    return _resource(service)


@router.post("/cell/stop", responses=problem_responses())
async def stop_cell(request: Request, service: Service) -> CellResource:
    """Stops the arm at once, whatever goes on; a live scan or calibration under way is aborted, and ends a moment
    behind the answer. What was asked for before and does not move yet is refused. Not an emergency stop."""
    stopped = await to_thread.run_sync(service.jobs.stop_arm, limiter=service.stopping)
    request.state.stopped_scan = stopped  # for logs
    # Asks neither the database nor the disk: a locked or a slow one may not keep the next stop waiting.
    warnings = calibration_warnings(None, service.jobs.drift.latest, service.store.calibrations)
    return _told(service, _InUse(None, warnings))


@router.post("/cell/release", responses=problem_responses(*CELL, "not-ready"))
def release_arm(service: Service) -> CellResource:
    """Ends our program on the robot, so that another can move it, as to grasp. Waits for the arm of a scan to come home
    first; refused as `stopped` when somebody stops it meanwhile. Asked for behind a stop, it leaves the arm where it
    stands. The next live scan, or connect, takes the arm again. Nothing moves."""
    service.jobs.release_arm(arrived_s())
    return _resource(service)


_AGAIN = {"Retry-After": {"description": "Seconds, where it is `too-early`", "schema": {"type": "integer"}}}
_ACKNOWLEDGE = problem_responses(*CELL, "no-fault", "not-ready", "too-early")
_ACKNOWLEDGE[409]["headers"] = _AGAIN


@router.post("/cell/acknowledge", responses=_ACKNOWLEDGE)
def acknowledge_fault(service: Service) -> CellResource:
    """Says that a person has looked at the cell after a fault. Unlocks a protective stop; nothing moves."""
    service.cell.acknowledge()
    return _resource(service)


@router.post(
    "/viewpoints/plan",
    response_model=PlanDocument,
    responses=problem_responses("calibration", "config", "invalid-request", "viewpoints-unreachable"),
)
async def plan_viewpoints(service: Service, wanted: PlanRequest | None = None) -> Any:
    """The viewpoints, which of them can be reached and why not, their order and the way. Nothing moves."""
    views = wanted.views if wanted else None
    return await to_thread.run_sync(lambda: service.cell.plan(views).to_json(), limiter=service.planning)


PNG: dict[int | str, dict[str, Any]] = {200: {"content": {"image/png": BINARY}}}


@router.get(
    "/viewpoints/plan.png",
    response_class=Response,
    responses=PNG | problem_responses("calibration", "config", "invalid-request", "viewpoints-unreachable"),
)
async def draw_viewpoints(service: Service, views: ViewCount = None) -> Response:
    """The same as a picture."""

    def draw() -> bytes:
        from cell.planning.plan_plot import draw_plan

        return draw_plan(service.cell.plan(views), service.cell.settings)

    return Response(await to_thread.run_sync(draw, limiter=service.planning), media_type="image/png")


@dataclass(frozen=True)
class _InUse:
    """The calibration in use, as far as it is known."""

    hand_eye: HandEye | None
    warnings: list[CellWarning]


def _in_use(service: Context) -> _InUse:
    """As its file is now: one may have been activated since the cell was connected."""
    hand_eye = usable_hand_eye(service.cell)
    drift = None if hand_eye is None else recent_drift(hand_eye, service.jobs.drift)
    return _InUse(hand_eye, calibration_warnings(hand_eye, drift, service.store.calibrations))


def _resource(service: Context) -> CellResource:
    return _told(service, _in_use(service))


def _told(service: Context, in_use: _InUse) -> CellResource:
    """From memory alone."""
    status = service.cell.status
    if in_use.hand_eye is not None:
        status = replace(status, hand_eye=in_use.hand_eye)
    return cell_resource(status, service.cell.settings, service.jobs.using_arm, in_use.warnings)
