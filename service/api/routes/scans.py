"""Routes of scans: start, reprocess, list, read, cancel, keep."""

import sqlite3
from collections.abc import Callable
from functools import partial
from typing import Any

from anyio import from_thread, to_thread
from fastapi import APIRouter, Request, Response

from cell.errors import StoppedError
from cell.planning.viewpoints import ViewpointPlan
from service.api.dependencies import Before, Context, Id, Limit, Scan, Service, find_scan
from service.api.idempotency_header import RequesterDependency
from service.api.openapi import links
from service.api.pagination import Filter, paginate
from service.api.problem_responses import problem_responses
from service.api.response_cache import json_response
from service.api.routes.recordings import require_recording_file
from service.api.schemas.addresses import SCANS
from service.api.schemas.cell import viewpoints_resource
from service.api.schemas.scan_resource import scan_resource, scan_resources
from service.api.schemas.scan_validation import ScanValidation
from service.api.schemas.scans import (
    KeepRequest,
    LiveScanRequest,
    ReplayScanRequest,
    ReprocessRequest,
    ScanList,
    ScanRequest,
    ScanResource,
    requested_members,
)
from service.jobs.submission import Requester
from service.logs.request_time import arrival_time
from service.problems.problem_error import ProblemError
from service.security.auth.caller import caller_of
from service.states import ACTIVE_STATES
from service.storage.removal import remove
from service.storage.rows import RecordingRow, ScanRow

router = APIRouter(prefix=SCANS, tags=["scans"])

_SUBMIT = (
    "cell-busy", "idempotency-key", "idempotency-mismatch", "idempotency-pending", "invalid-parameters",
    "invalid-request", "no-result", "not-ready", "recording-not-found", "storage-full", "too-large",
)  # fmt: skip
"""Problem types of an operation that starts a scan."""
STARTED: dict[int | str, dict[str, Any]] = {
    202: {"description": "The scan is accepted; follow it until it is `final`"}
    | links(
        *("get_scan", "stream_scan_events", "cancel_scan", "keep_scan", "reprocess_scan"),
        *("get_model", "get_grasps", "get_cloud", "get_preview", "get_thumbnail", "get_views", "get_scan_recording"),
    )
}


_VALIDATED: dict[int | str, dict[str, Any]] = {
    200: {"model": ScanValidation, "description": "The request is valid; no scan was started (`validate_only`)"}
}
_KNOWN_AT_ONCE = ("acknowledge-required", "calibration", "config", "stopped", "viewpoints-unreachable")
"""Problems of the cell that refuse a live scan. All others are known later, and become the problem of the scan."""
_START = STARTED | _VALIDATED | problem_responses(*_SUBMIT, *_KNOWN_AT_ONCE)


@router.post("", status_code=202, response_model=ScanResource, responses=_START)
def start_scan(
    body: ScanRequest, response: Response, service: Service, scan_caller: RequesterDependency
) -> ScanResource | Response:
    """Start a scan. The header Location has its address, at which its progress can be read.

    The answer comes at once. Only one job runs at a time: 409 names the running one. A live scan is refused if a fault
    is not acknowledged, or if there is no usable calibration. It begins in the state `connecting`: if arm or camera
    cannot be used then, or too few viewpoints can be reached, the scan fails and its `problem` says why.

    With `validate_only` the request is checked and the viewpoints are planned. No scan is started, no device is
    contacted, and an Idempotency-Key is not used up. The answer is 200, or the refusal.
    """
    if body.validate_only:
        return json_response(_validate(body, service))
    requester = scan_caller.requester(body)

    def submit(requested_at: float) -> ScanRow:
        gripper = service.config.cell.gripper.to_gripper()
        if isinstance(body, LiveScanRequest):
            request = body.recognition_request(gripper, service.config.cell.scan.string_radius_m)
            service.jobs.raise_if_stopped_since(requested_at)
            return service.jobs.submit.live(body.views, request, arrival_time(), requester)
        recording = _usable_recording(body.recording, service)
        request = body.recognition_request(gripper, recording.string_radius_m)
        return service.jobs.submit.replay(recording, request, requester)

    return _start(response, service, requester, submit)


@router.post(
    "/{id}/reprocess",
    status_code=202,
    responses=STARTED | problem_responses(*_SUBMIT, "result-not-ready", "scan-not-found", "stopped"),
)
def reprocess_scan(
    source: Scan,
    response: Response,
    service: Service,
    scan_caller: RequesterDependency,
    body: ReprocessRequest | None = None,
) -> ScanResource:
    """Recognise the recording of a scan again, as a new scan. Nothing moves.

    The first scan may have ended in any state, for example `interrupted`. Members that the request omits are as in the
    first scan. A radius of null is measured.
    """
    body = body or ReprocessRequest()
    requester = scan_caller.requester(body)

    def submit(_: float) -> ScanRow:
        if source.state in ACTIVE_STATES:
            raise ProblemError(
                "result-not-ready",
                f"scan {source.id} is {source.state}; wait for its end",
                scan=source.id,
                state=source.state,
            )
        recording = service.store.recording(source.recording) if source.recording else None
        if recording is None:
            raise ProblemError("no-result", f"scan {source.id} has no recording", scan=source.id)
        require_recording_file(service, recording)
        request = body.recognition_request(service.config.cell.gripper.to_gripper(), source.request)
        return service.jobs.submit.replay(recording, request, requester, source.id)

    return _start(response, service, requester, submit)


@router.get("", response_model=ScanList, responses=problem_responses("invalid-request"))
async def list_scans(
    request: Request, service: Service, filters: Filter, limit: Limit = 100, before: Before = None
) -> Response:
    """Return the scans that match all filters, the newest first."""

    def read() -> Response:
        rows, following = paginate(service.store.scans.newest(limit + 1, before, filters), limit, request)
        scans = scan_resources(rows, service.store.scans.views([row.id for row in rows]))
        return json_response(ScanList(scans=scans, next=following))

    return await service.response_cache.respond(("scans", request.url.query), read)


@router.get("/{id}", response_model=ScanResource, responses=problem_responses("scan-not-found", "invalid-request"))
async def get_scan(id: Id, service: Service) -> Response:  # noqa: A002 (the path's own name)
    """Return the state, progress and results of a scan."""
    return await service.response_cache.respond(
        ("scan", id), lambda: json_response(_resource(find_scan(id, service), service))
    )


@router.post("/{id}/cancel", responses=problem_responses("scan-not-found", "not-cancellable", "invalid-request"))
async def cancel_scan(id: Id, request: Request, service: Service) -> ScanResource:  # noqa: A002 (the path's own name)
    """Cancel a scan. The scan may have ended just before; the answer has its state."""

    def cancel() -> ScanResource:
        service.jobs.cancel(id, lambda: find_scan(id, service), caller_of(request).token_name)
        return _resource(find_scan(id, service), service)

    return await to_thread.run_sync(cancel, limiter=service.stopping)


@router.put("/{id}/keep", responses=problem_responses("scan-not-found", "too-large", "invalid-request"))
def keep_scan(id: Id, body: KeepRequest, service: Service) -> ScanResource:  # noqa: A002 (the path's own name)
    """Mark a scan to be kept at any age, with its results and its recording; or remove the mark."""
    service.store.scans.keep(id, body.kept)
    return _resource(find_scan(id, service), service)


DELETE_PROBLEMS = problem_responses("scan-not-found", "scan-active", "scan-kept", "invalid-request")


@router.delete("/{id}", status_code=204, responses=DELETE_PROBLEMS)
def delete_scan(id: Id, service: Service) -> None:  # noqa: A002 (the path's own name)
    """Remove a scan that has ended, with its results, events and idempotency key.

    Its recording is removed too, if no other scan uses it. A scan that a person marked to be kept is not removed.
    """
    scan = find_scan(id, service)
    if scan.kept:
        detail = f'scan {id} is marked to be kept; first send {{"kept": false}} by PUT {SCANS}/{id}/keep'
        raise ProblemError("scan-kept", detail, scan=id)
    if remove(service.store, "scan", id) is None:
        state = find_scan(id, service).state
        raise ProblemError("scan-active", f"scan {id} is {state}; wait for its end, or cancel it", scan=id, state=state)


def _validate(body: ReplayScanRequest | LiveScanRequest, service: Context) -> ScanValidation:
    """Check a request as far as that is possible without a device. Raises what refuses the scan."""
    service.require_space()
    gripper = service.config.cell.gripper.to_gripper()
    recording = None
    viewpoints = None
    if isinstance(body, LiveScanRequest):
        views = body.views
        requested_at = arrival_time()
        request = body.recognition_request(gripper, service.config.cell.scan.string_radius_m)
        service.jobs.raise_if_busy()

        def validate() -> ViewpointPlan:
            return service.cell.validate_scan(views, requested_at)

        plan = from_thread.run(partial(to_thread.run_sync, limiter=service.planning), validate)
        viewpoints = viewpoints_resource(plan)
    else:
        recording = _usable_recording(body.recording, service)
        request = body.recognition_request(gripper, recording.string_radius_m)
        service.jobs.raise_if_busy()
    return ScanValidation(
        valid=True,
        mode=body.mode,
        recording=None if recording is None else recording.id,
        **requested_members(request),
        viewpoints=viewpoints,
    )


def _usable_recording(recording_id: str, service: Context) -> RecordingRow:
    """Return a recording with its file, or raise ProblemError."""
    recording = service.store.recording(recording_id)
    if recording is None:
        raise ProblemError(
            "recording-not-found", f"there is no recording {recording_id}; upload it first", recording=recording_id
        )
    require_recording_file(service, recording)
    return recording


def _resource(scan: ScanRow, service: Context) -> ScanResource:
    return scan_resource(scan, service.store.scans.views([scan.id]))


def _start(
    response: Response, service: Context, requester: Requester, submit: Callable[[float], ScanRow]
) -> ScanResource:
    """Return the scan that `submit` starts, or the one that an earlier request with the same key has started.

    Args:
        response: The response, which gets the header Location.
        service: The running service.
        requester: The caller and the idempotency key.
        submit: Starts the scan. Its argument is the time of the first request with the key, in seconds of
            `time.monotonic()`.
    """
    with service.keys.first_use(requester.key, arrival_time()) as scan_or_time:
        if isinstance(scan_or_time, ScanRow):
            response.headers["Location"] = f"{SCANS}/{scan_or_time.id}"
            response.headers["Idempotency-Replayed"] = "true"
            return _resource(scan_or_time, service)
        service.require_space()
        try:
            scan = submit(scan_or_time)
        except sqlite3.IntegrityError as error:
            raise ProblemError(
                "recording-not-found", "the recording was removed a moment ago; upload it again"
            ) from error
        except StoppedError as error:
            if requester.key is None:
                raise
            raise StoppedError(f"{error}; a new request needs a new Idempotency-Key") from None
    response.headers["Location"] = f"{SCANS}/{scan.id}"
    return scan_resource(scan, ())  # as accepted, because reading its later state could fail
