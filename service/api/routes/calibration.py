"""Routes of hand-eye calibration: the calibration in use, and calibrations and verifications by the cell."""

from typing import Annotated, Any

from anyio import to_thread
from fastapi import APIRouter, Depends, Path, Request, Response
from fastapi.responses import FileResponse

from calibration.target.board import BoardError
from cell.errors import CellError
from service.api.dependencies import REQUIRE_SPACE, Before, Id, Limit, Service
from service.api.file_responses import NOT_MODIFIED, IfNoneMatch, send_file
from service.api.openapi import links
from service.api.problem_responses import CELL, problem_responses
from service.api.routes.recordings import BINARY
from service.api.schemas.addresses import RUNS
from service.api.schemas.calibration import BoardRequest, CalibrationRequest, CalibrationStatus, RunList, RunResource
from service.api.schemas.calibration_resources import active_calibration, calibration_warnings, run_resource
from service.jobs.calibration_activation import activate_result
from service.jobs.calibration_job import picture_file, run_folder
from service.logs.request_time import arrival_time
from service.problems.problem_error import ProblemError
from service.security.auth.caller import caller_of
from service.storage.rows import CalibrationRow

router = APIRouter(prefix="/api/calibration", tags=["calibration"])


def _find(id: Id, service: Service) -> CalibrationRow:  # noqa: A002 (the path's own name)
    row = service.store.calibrations.get(id)
    if row is None:
        raise ProblemError(
            "calibration-not-found", f"there is no calibration {id}; GET {RUNS} lists them", calibration=id
        )
    return row


Run = Annotated[CalibrationRow, Depends(_find)]
"""The run that the path names, or a problem with status 404."""
Index = Annotated[int, Path(ge=0, le=999)]
_SUBMIT = (*CELL, "not-ready", "storage-full", "viewpoints-unreachable")
"""Problem types of an operation that starts a run."""
_ACTIVATE = (
    "calibration", "calibration-in-future", "calibration-invalid", "calibration-mismatch", "calibration-missing",
    "calibration-not-found", "calibration-refused", "calibration-stale", "calibration-unreadable", "cell-busy",
    "invalid-request", "not-activatable", "result-not-ready",
)  # fmt: skip
STARTED = {202: links("get_run", "cancel_run", "activate_run", "get_run_image")}


@router.get("", responses=problem_responses())
def get_calibration(service: Service) -> CalibrationStatus:
    """Return the calibration in use: its uncertainty, its age, and the drift that recent scans show.

    No device is contacted.
    """
    running = service.jobs.calibration
    calibration, reason, hand_eye, drift = None, None, None, None
    try:
        hand_eye = service.cell.hand_eye()
        drift = service.jobs.drift.drift(hand_eye)
        calibration = active_calibration(hand_eye, drift)
    except CellError as error:
        reason = str(error)
    return CalibrationStatus(
        calibration=calibration,
        reason=reason,
        warnings=calibration_warnings(hand_eye, drift, service.store.calibrations),
        active_run=None if running is None else f"{RUNS}/{running}",
    )


@router.post(
    "/runs",
    status_code=202,
    dependencies=[REQUIRE_SPACE],
    responses=STARTED | problem_responses(*_SUBMIT, "calibration-board", "invalid-request"),
)
def start_run(response: Response, service: Service, body: CalibrationRequest | None = None) -> RunResource:
    """Start a calibration. The arm moves through poses from which the camera sees the board.

    The board must lie flat on the table in the middle of the workspace. The result is not used until it is activated.
    Only one job runs at a time: 409 names the running one.
    """
    body = body or CalibrationRequest()
    try:
        board = (body.board or BoardRequest()).board()
    except BoardError as error:
        raise ProblemError(error.slug, str(error)) from error
    row = service.jobs.submit.calibration(board, body.poses, arrival_time())
    response.headers["Location"] = f"{RUNS}/{row.id}"
    return run_resource(row, ())


@router.post("/verify", status_code=202, dependencies=[REQUIRE_SPACE], responses=STARTED | problem_responses(*_SUBMIT))
def start_verification(response: Response, service: Service) -> RunResource:
    """Start a verification of the calibration in use. The arm moves to two poses and observes the board.

    The board of that calibration must lie on the table. The result says whether the calibration is still valid, and
    whether the board was moved. A verification is a run of its own.
    """
    row = service.jobs.submit.verification(arrival_time())
    response.headers["Location"] = f"{RUNS}/{row.id}"
    return run_resource(row, ())


@router.get("/runs", responses=problem_responses("invalid-request"))
def list_runs(service: Service, limit: Limit = 100, before: Before = None) -> RunList:
    """Return the calibrations and verifications, the newest first."""
    rows = service.store.calibrations.newest(limit, before)
    views = service.store.calibrations.views([row.id for row in rows])
    return RunList(runs=[run_resource(row, [view for view in views if view.calibration == row.id]) for row in rows])


@router.get("/runs/{id}", responses=problem_responses("calibration-not-found", "invalid-request"))
def get_run(run: Run, service: Service) -> RunResource:
    """Return the state, progress and result of a run."""
    return run_resource(run, service.store.calibrations.views([run.id]))


@router.post(
    "/runs/{id}/cancel",
    responses=problem_responses("calibration-not-found", "not-cancellable", "invalid-request"),
)
async def cancel_run(id: Id, request: Request, service: Service) -> RunResource:  # noqa: A002 (the path's own name)
    """Cancel a run. The arm is stopped first.

    The run may have ended just before; the answer has its state.
    """

    def cancel() -> RunResource:
        service.jobs.cancel(id, lambda: _find(id, service), caller_of(request).token_name)
        return get_run(_find(id, service), service)

    return await to_thread.run_sync(cancel, limiter=service.stopping)


@router.post("/runs/{id}/activate", responses=problem_responses(*_ACTIVATE))
def activate_run(run: Run, service: Service) -> RunResource:
    """Make the result the calibration in use, from the next scan on.

    The previous calibration is kept beside it. A result cannot be activated while a job is running.
    """
    with service.jobs.exclusive():
        activate_result(run, service.store.calibrations, service.cell)
    return get_run(_find(run.id, service), service)


PNG: dict[int | str, dict[str, Any]] = {200: {"content": {"image/png": BINARY}}} | NOT_MODIFIED


@router.get(
    "/runs/{id}/views/{index}.png",
    response_class=FileResponse,
    responses=PNG | problem_responses("calibration-not-found", "no-result", "invalid-request"),
)
def get_run_image(run: Run, index: Index, service: Service, if_none_match: IfNoneMatch) -> Response:
    """Return the image that was captured at a view."""
    path = picture_file(run_folder(service.cell, run.id), index)
    if path is None:
        raise ProblemError(
            "no-result", f"{run.kind} {run.id} has no image of view {index}", calibration=run.id, view=index
        )
    return send_file(path, "image/png", if_none_match)
