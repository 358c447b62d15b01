"""Scans: start, do again, follow, list, cancel, keep."""

import sqlite3
from collections.abc import Callable

from anyio import to_thread
from fastapi import APIRouter, Request, Response

from cell.errors import StoppedError
from service.api.dependencies import Before, Context, Id, Limit, Scan, Service, find_scan
from service.api.idempotency_header import Asks
from service.api.openapi import links
from service.api.pagination import Filter, page
from service.api.problem_responses import CELL, problem_responses
from service.api.response_cache import json_answer
from service.api.routes.recordings import require_whole
from service.api.schemas.addresses import SCANS
from service.api.schemas.scan_resource import scan_resource, scan_resources
from service.api.schemas.scans import Keep, LiveScan, Reprocess, ScanList, ScanRequest, ScanResource
from service.jobs.new_rows import Asked
from service.logs.request_time import arrived_s
from service.problems.problem_error import ProblemError
from service.processing.results import check_radius
from service.states import ACTIVE_STATES
from service.storage.rows import ScanRow

router = APIRouter(prefix=SCANS, tags=["scans"])

_SUBMIT = (
    "cell-busy", "idempotency-key", "idempotency-mismatch", "idempotency-pending", "invalid-parameters",
    "invalid-request", "no-result", "not-ready", "recording-not-found", "storage-full", "too-large",
)  # fmt: skip
"""Problems of an operation that starts a scan."""
STARTED = {
    202: links(
        *("get_scan", "follow_scan", "cancel_scan", "keep_scan", "reprocess_scan"),
        *("get_model", "get_grasps", "get_cloud", "get_preview", "get_thumbnail", "get_views", "get_scan_recording"),
    )
}


@router.post("", status_code=202, responses=STARTED | problem_responses(*_SUBMIT, *CELL, "viewpoints-unreachable"))
def start_scan(wanted: ScanRequest, response: Response, service: Service, asking: Asks) -> ScanResource:
    """Starts a scan; follow it at the address in Location. One at a time: 409 names the one under way.

    A live scan is accepted once arm, camera and calibration are ready and enough viewpoints can be reached.
    """
    asked = asking.asked(wanted)

    def submit(wished_s: float) -> ScanRow:
        if isinstance(wanted, LiveScan):
            radius = check_radius(wanted.string_radius_m, service.config.cell.scan.string_radius_m)
            service.jobs.refuse_stopped_since(wished_s)
            return service.jobs.submit.live(wanted.views, wanted.method, radius, arrived_s(), asked)
        recording = service.store.recording(wanted.recording)
        if recording is None:
            raise ProblemError("recording-not-found", f"there is no recording {wanted.recording}; upload it first")
        require_whole(service, recording)
        radius = check_radius(wanted.string_radius_m, recording.string_radius_m)
        return service.jobs.submit.replay(recording, wanted.method, radius, asked)

    return _start(response, service, asked, submit)


@router.post(
    "/{id}/reprocess",
    status_code=202,
    responses=STARTED | problem_responses(*_SUBMIT, "result-not-ready", "scan-not-found", "stopped"),
)
def reprocess_scan(
    source: Scan, response: Response, service: Service, asking: Asks, wanted: Reprocess | None = None
) -> ScanResource:
    """Recognises what a scan has recorded again, as a scan of its own: whatever became of the first one, also where it
    was interrupted. Nothing moves. What the request leaves out is as in the first; a radius of null is measured."""
    wanted = wanted or Reprocess()
    asked = asking.asked(wanted)

    def submit(_: float) -> ScanRow:
        if source.state in ACTIVE_STATES:
            raise ProblemError("result-not-ready", f"scan {source.id} is {source.state}; wait for its end")
        recording = service.store.recording(source.recording) if source.recording else None
        if recording is None:
            raise ProblemError("no-result", f"scan {source.id} has no recording")
        require_whole(service, recording)
        given = "string_radius_m" in wanted.model_fields_set
        radius = check_radius(wanted.string_radius_m if given else source.string_radius_m, None)
        return service.jobs.submit.replay(recording, wanted.method or source.method, radius, asked, source.id)

    return _start(response, service, asked, submit)


@router.get("", response_model=ScanList, responses=problem_responses("invalid-request"))
async def list_scans(
    request: Request, service: Service, wanted: Filter, limit: Limit = 100, before: Before = None
) -> Response:
    """The scans, the newest first; each of the filters must hold."""

    def read() -> Response:
        rows, following = page(service.store.scans(limit + 1, before, wanted), limit, request)
        scans = scan_resources(rows, service.store.views([row.id for row in rows]))
        return json_answer(ScanList(scans=scans, next=following))

    return await service.reading.answer(("scans", request.url.query), read)


@router.get("/{id}", response_model=ScanResource, responses=problem_responses("scan-not-found", "invalid-request"))
async def get_scan(id: Id, service: Service) -> Response:  # noqa: A002 (the path's own name)
    """State, progress and results of a scan."""
    return await service.reading.answer(("scan", id), lambda: json_answer(_told(find_scan(id, service), service)))


@router.post("/{id}/cancel", responses=problem_responses("scan-not-found", "not-cancellable", "invalid-request"))
async def cancel_scan(id: Id, service: Service) -> ScanResource:  # noqa: A002 (the path's own name)
    """Stops a scan. It may have ended just before: the answer says in which state it is."""

    def cancel() -> ScanResource:
        service.jobs.cancel(id, lambda: find_scan(id, service))
        return _told(find_scan(id, service), service)

    return await to_thread.run_sync(cancel, limiter=service.stopping)


@router.put("/{id}/keep", responses=problem_responses("scan-not-found", "too-large", "invalid-request"))
def keep_scan(id: Id, wanted: Keep, service: Service) -> ScanResource:  # noqa: A002 (the path's own name)
    """Marks a scan, with its results and its recording, as one to be kept however old it gets; or no longer."""
    service.store.keep_scan(id, wanted.kept)
    return _told(find_scan(id, service), service)


def _told(scan: ScanRow, service: Context) -> ScanResource:
    return scan_resource(scan, service.store.views([scan.id]))


def _start(response: Response, service: Context, asked: Asked, submit: Callable[[float], ScanRow]) -> ScanResource:
    """The scan that `submit` starts, told since when it is asked for; or the one that a request with the same key has
    started."""
    with service.keys.first_use(asked.key, arrived_s()) as known:
        if isinstance(known, ScanRow):
            response.headers["Location"] = f"{SCANS}/{known.id}"
            response.headers["Idempotency-Replayed"] = "true"
            return _told(known, service)
        service.require_space()
        try:
            scan = submit(known)
        except sqlite3.IntegrityError as error:
            raise ProblemError("recording-not-found", "the recording was removed a moment ago") from error
        except StoppedError as error:
            if asked.key is None:
                raise
            raise StoppedError(f"{error}; what is still wanted needs a new Idempotency-Key") from None
    response.headers["Location"] = f"{SCANS}/{scan.id}"
    return scan_resource(scan, ())  # as accepted: what it has become since is not worth a refusal
