"""Scans: start, follow, cancel, and their results."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from anyio import to_thread
from fastapi import APIRouter, Response
from fastapi.responses import FileResponse

from service.context import Before, Context, Id, Limit, Scan, Service, find_scan
from service.data_folder import CLOUD, MODEL, PREVIEW
from service.model_schema import GraspsDocument, ModelDocument
from service.problems import ProblemError, problem_responses
from service.routes import recordings
from service.routes.files import WholeFile, existing
from service.schemas import (
    ACTIVE_STATES,
    RESULT_STATES,
    LiveScan,
    Problem,
    Progress,
    ScanLinks,
    ScanList,
    ScanRequest,
    ScanResource,
    ScanSummary,
    ViewProgress,
)
from service.tables import ScanRow, ViewRow
from service.workflow import check_radius

PATH = "/api/scans"

router = APIRouter(prefix=PATH, tags=["scans"])


@router.post("", status_code=202, responses=problem_responses(404, 409, 413, 422, 503))
def start_scan(wanted: ScanRequest, response: Response, service: Service) -> ScanResource:
    """Starts a scan; follow it at the address in Location. One at a time: 409 names the one under way.

    A live scan is accepted once arm, camera and calibration are ready and enough viewpoints can be reached.
    """
    if isinstance(wanted, LiveScan):
        radius = check_radius(wanted.string_radius_m, service.config.cell.scan.string_radius_m)
        scan = service.jobs.submit_live(wanted.views, wanted.method, radius)
    else:
        recording = service.store.recording(wanted.recording)
        if recording is None:
            raise ProblemError(404, "recording-not-found", f"there is no recording {wanted.recording}; upload it first")
        radius = check_radius(wanted.string_radius_m, recording.string_radius_m)
        scan = service.jobs.submit_replay(recording, wanted.method, radius)
    response.headers["Location"] = f"{PATH}/{scan.id}"
    return _resource(scan, ())


@router.get("", responses=problem_responses(422))
def list_scans(service: Service, limit: Limit = 100, before: Before = None) -> ScanList:
    """The scans, the newest first."""
    rows = service.store.scans(limit, before)
    views = service.store.views([row.id for row in rows])
    return ScanList(scans=[_resource(row, [view for view in views if view.scan == row.id]) for row in rows])


@router.get("/{id}", responses=problem_responses(404, 422))
def get_scan(scan: Scan, service: Service) -> ScanResource:
    """State, progress and results of a scan."""
    return _resource(scan, service.store.views([scan.id]))


@router.post("/{id}/cancel", responses=problem_responses(404, 409, 422))
async def cancel_scan(id: Id, service: Service) -> ScanResource:  # noqa: A002 (the path's own name)
    """Stops a scan. It may have ended just before: the answer says in which state it is."""

    def cancel() -> ScanResource:
        service.jobs.cancel(find_scan(id, service))
        return _resource(find_scan(id, service), service.store.views([id]))

    return await to_thread.run_sync(cancel, limiter=service.stopping)


def _file(media_type: str) -> dict[int | str, dict[str, Any]]:
    return {200: {"content": {media_type: recordings.BINARY}}}


@router.get(
    "/{id}/model",
    response_class=FileResponse,
    responses={200: {"model": ModelDocument, "content": {"application/json": {}}}} | problem_responses(404, 409, 422),
)
def get_model(scan: Scan, service: Service) -> WholeFile:
    """The point chain model."""
    return _result(scan, service, MODEL, "application/json")


@router.get("/{id}/grasps", response_model=GraspsDocument, responses=problem_responses(404, 409, 422))
def get_grasps(scan: Scan, service: Service) -> dict[str, Any]:
    """Where the configured gripper can take the strings, the best first."""
    model = json.loads(_result_path(scan, service, MODEL).read_bytes())
    if "grasps" not in model:
        raise ProblemError(404, "no-result", f"scan {scan.id} is of an older version, without grasps: scan again")
    return {key: model[key] for key in ("schema", "frame", "grasps")}


PLY = "application/octet-stream"


@router.get("/{id}/cloud.ply", response_class=FileResponse, responses=_file(PLY) | problem_responses(404, 409, 422))
def get_cloud(scan: Scan, service: Service) -> WholeFile:
    """The merged cloud: binary PLY, metres, base frame."""
    return _result(scan, service, CLOUD, PLY, f"{scan.id}.ply")


@router.get(
    "/{id}/preview.png",
    response_class=FileResponse,
    responses=_file("image/png") | problem_responses(404, 409, 422),
)
def get_preview(scan: Scan, service: Service) -> WholeFile:
    """The result from above: cloud, chains, crossings. Drawn behind the model: the first to ask may wait a moment."""
    if scan.state in RESULT_STATES:
        service.jobs.wait_for_preview(scan.id)
    return _result(scan, service, PREVIEW, "image/png")


@router.get(
    "/{id}/recording",
    response_class=FileResponse,
    responses=_file(recordings.MCAP) | problem_responses(404, 422),
)
def get_scan_recording(scan: Scan, service: Service) -> WholeFile:
    """The recording that the scan is of, whatever became of the scan."""
    recording = service.store.recording(scan.recording) if scan.recording else None
    if recording is None:
        raise ProblemError(404, "no-result", f"scan {scan.id} has no recording")
    return recordings.recording_file(service, recording)


def _result(scan: ScanRow, service: Context, name: str, media_type: str, save_as: str | None = None) -> WholeFile:
    return WholeFile(_result_path(scan, service, name), media_type, save_as)


def _result_path(scan: ScanRow, service: Context, name: str) -> Path:
    if scan.state in ACTIVE_STATES:
        raise ProblemError(409, "result-not-ready", f"scan {scan.id} is {scan.state}; wait for its end")
    if scan.state not in RESULT_STATES:
        raise ProblemError(404, "no-result", f"scan {scan.id} is {scan.state}: it has no result")
    return existing(service.store.folder.results(scan.id) / name)


def _resource(row: ScanRow, views: Sequence[ViewRow]) -> ScanResource:
    own = f"{PATH}/{row.id}"
    done = row.state in RESULT_STATES
    return ScanResource(
        id=row.id,
        mode=row.mode,
        recording=row.recording,
        method=row.method,
        string_radius_m=row.string_radius_m,
        state=row.state,
        progress=Progress(
            stage=row.stage,
            fraction=row.fraction,
            views=[ViewProgress(index=view.view, state=view.state, reason=view.reason) for view in views],
        ),
        created_at=row.created_at,
        started_at=row.started_at,
        ended_at=row.ended_at,
        summary=ScanSummary.model_validate(row.summary) if row.summary else None,
        problem=Problem.model_validate(row.problem | {"instance": own}) if row.problem else None,
        links=ScanLinks(
            self=own,
            cancel=f"{own}/cancel" if row.state in ACTIVE_STATES else None,
            recording=f"{own}/recording" if row.recording else None,
            model=f"{own}/model" if done else None,
            grasps=f"{own}/grasps" if done else None,
            cloud=f"{own}/cloud.ply" if done else None,
            preview=f"{own}/preview.png" if done else None,
        ),
    )
