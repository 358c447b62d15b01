"""What a scan gave: model, grasps, cloud, picture, recording. A client that has it already is told so by its ETag."""

import asyncio
import json
import time
from pathlib import Path
from typing import Any

from fastapi import APIRouter, Response
from fastapi.responses import FileResponse

from recognition.model.document import ModelDocument
from service.api.dependencies import Context, Id, Scan, Service, find_scan
from service.api.etags import matches
from service.api.file_responses import NOT_MODIFIED, IfNoneMatch, not_modified, present, read_whole, send_file
from service.api.image_cache import shrink_picture
from service.api.problem_responses import problem_responses
from service.api.routes import recordings
from service.api.schemas.addresses import SCANS
from service.api.schemas.scans import GraspsDocument
from service.problems.problem_error import ProblemError
from service.processing.worker import PREVIEW_S
from service.states import ACTIVE_STATES, RESULT_STATES
from service.storage.data_folder import CLOUD, MODEL, PREVIEW
from service.storage.rows import ScanRow

router = APIRouter(prefix=SCANS, tags=["scans"])

Responses = dict[int | str, dict[str, Any]]
REFUSALS: Responses = NOT_MODIFIED | problem_responses(
    "scan-not-found", "no-result", "result-not-ready", "invalid-request"
)
PLY = "application/octet-stream"
THUMBNAIL = 240
"""Pixels across."""
LOOK_S = 0.02
"""How often it is looked whether a picture is there."""


def _file(media_type: str) -> Responses:
    return {200: {"content": {media_type: recordings.BINARY}}}


JSON: Responses = {200: {"model": ModelDocument, "content": {"application/json": {}}}}


@router.get("/{id}/model", response_class=FileResponse, responses=JSON | REFUSALS)
async def get_model(id: Id, service: Service, has: IfNoneMatch) -> Response:  # noqa: A002 (the path's own name)
    """The point chain model."""

    def read() -> Response:
        return _send(find_scan(id, service), service, MODEL, "application/json", has)

    return await service.reading.answer(("model", id, has), read)


@router.get("/{id}/grasps", response_model=GraspsDocument, responses=REFUSALS)
def get_grasps(scan: Scan, service: Service, response: Response, has: IfNoneMatch) -> Any:
    """Where the configured gripper can take the strings, the best first."""
    path = _result(scan, service, MODEL)
    _, of_model = present(path, **_as_written(scan, MODEL))
    etag = f'{of_model[:-1]}-grasps"'
    if matches(has, etag):
        return not_modified(etag)
    model = json.loads(path.read_bytes())
    if "grasps" not in model:
        raise ProblemError("no-result", f"scan {scan.id} is of an older version, without grasps: scan again")
    response.headers["ETag"] = etag
    return {key: model[key] for key in ("schema", "frame", "grasps")}


@router.get("/{id}/cloud.ply", response_class=FileResponse, responses=_file(PLY) | REFUSALS)
def get_cloud(scan: Scan, service: Service, has: IfNoneMatch) -> Response:
    """The merged cloud: binary PLY, metres, base frame."""
    return _send(scan, service, CLOUD, PLY, has, f"{scan.id}.ply")


@router.get("/{id}/preview.png", response_class=FileResponse, responses=_file("image/png") | REFUSALS)
async def get_preview(id: Id, service: Service, has: IfNoneMatch) -> Response:  # noqa: A002 (the path's own name)
    """The result from above: cloud, chains, crossings. Drawn behind the model: the first to ask may wait a moment."""
    await _drawn(id, service)

    def read() -> Response:
        return _send(find_scan(id, service), service, PREVIEW, "image/png", has)

    return await service.reading.answer(("preview", id, has), read)


@router.get("/{id}/thumbnail.png", response_class=Response, responses=_file("image/png") | REFUSALS)
async def get_thumbnail(id: Id, service: Service, has: IfNoneMatch) -> Response:  # noqa: A002 (the path's own name)
    """The same in small."""
    await _drawn(id, service)

    def look() -> tuple[Path, int, str]:
        path = _result(find_scan(id, service), service, PREVIEW)
        found, etag = present(path)
        return path, found.st_size, etag

    path, size_bytes, etag = await service.reading.known(("thumbnail", id), look)
    return await service.pictures.answer(
        (id, etag), has, lambda: shrink_picture(read_whole(path, size_bytes), THUMBNAIL)
    )


RECORDING: Responses = (
    _file(recordings.MCAP) | NOT_MODIFIED | problem_responses("scan-not-found", "no-result", "invalid-request")
)


@router.get("/{id}/recording", response_class=FileResponse, responses=RECORDING)
def get_scan_recording(scan: Scan, service: Service, has: IfNoneMatch) -> Response:
    """The recording that the scan is of, whatever became of the scan."""
    recording = service.store.recording(scan.recording) if scan.recording else None
    if recording is None:
        raise ProblemError("no-result", f"scan {scan.id} has no recording")
    return recordings.send_recording(service, recording, has)


async def _drawn(scan_id: str, service: Context) -> None:
    """Returns when the scan's picture is there, or will not be."""
    deadline = time.monotonic() + PREVIEW_S
    while service.jobs.draws(scan_id) and time.monotonic() < deadline:
        await asyncio.sleep(LOOK_S)  # no thread is held meanwhile


def _send(
    scan: ScanRow, service: Context, name: str, media_type: str, has: str | None, save_as: str | None = None
) -> Response:
    path = _result(scan, service, name)
    return send_file(path, media_type, has, save_as=save_as, **_as_written(scan, name))


def _result(scan: ScanRow, service: Context, name: str) -> Path:
    """Where a result's file is."""
    if scan.state in ACTIVE_STATES:
        raise ProblemError("result-not-ready", f"scan {scan.id} is {scan.state}; wait for its end")
    if scan.state not in RESULT_STATES:
        raise ProblemError("no-result", f"scan {scan.id} is {scan.state}: it has no result")
    return service.store.folder.results(scan.id) / name


def _as_written(scan: ScanRow, name: str) -> dict[str, Any]:
    """Hash and size of a result's file; none for the picture, and of what an earlier version wrote."""
    return (scan.files or {}).get(name, {})
