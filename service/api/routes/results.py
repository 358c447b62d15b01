"""Routes of the results of a scan: model, cloud, images, recording. All have an ETag."""

import asyncio
import time
from pathlib import Path
from typing import Annotated, Any

from fastapi import APIRouter, Query, Response
from fastapi.responses import FileResponse, JSONResponse

from recognition.model.document import ChangesDocument, ModelDocument
from service.api.dependencies import Context, Id, Scan, Service, find_scan
from service.api.file_responses import (
    NOT_MODIFIED,
    IfNoneMatch,
    matches,
    not_modified_response,
    read_file,
    send_file,
    stat_file,
)
from service.api.images.height_image import draw_heights
from service.api.images.image_cache import shrink_image
from service.api.problem_responses import problem_responses
from service.api.response_cache import json_response
from service.api.result_files import hash_and_size, read_height_map, read_model, result_path, tag_of_height_map
from service.api.routes import recordings
from service.api.schemas.addresses import SCANS
from service.api.schemas.scans import HeightMapDocument, height_map_document
from service.problems.problem_error import ProblemError
from service.processing.worker import PREVIEW_TIMEOUT_S
from service.storage.data_folder import CLOUD, MODEL, PREVIEW
from service.storage.rows import ScanRow

router = APIRouter(prefix=SCANS, tags=["scans"])

Responses = dict[int | str, dict[str, Any]]
FILE_RESPONSES: Responses = NOT_MODIFIED | problem_responses(
    "scan-not-found", "no-result", "result-not-ready", "invalid-request"
)
PLY = "application/octet-stream"
Since = Annotated[Id | None, Query(description="Id of an earlier scan of the same table")]
THUMBNAIL_WIDTH_PX = 240
"""Width of a thumbnail."""
POLL_INTERVAL_S = 0.02
"""Interval of checking whether the preview is drawn."""


def _file(media_type: str) -> Responses:
    return {200: {"content": {media_type: recordings.BINARY}}}


JSON: Responses = {200: {"model": ModelDocument, "content": {"application/json": {}}}}


@router.get("/{id}/model", response_class=FileResponse, responses=JSON | FILE_RESPONSES)
async def get_model(
    id: Id,  # noqa: A002 (the path's own name)
    service: Service,
    if_none_match: IfNoneMatch,
    since: Since = None,
) -> Response:
    """Return the point chain model.

    With `since`, the model has the member `since`: which chain of the other scan is which chain of this one, how it
    moved, and what is new or gone.
    """

    def read() -> Response:
        scan = find_scan(id, service)
        if since is None:
            return _send(scan, service, MODEL, "application/json", if_none_match)
        return _model_since(scan, find_scan(since, service), service, if_none_match)

    return await service.response_cache.respond(("model", id, since, if_none_match), read)


@router.get("/{id}/cloud.ply", response_class=FileResponse, responses=_file(PLY) | FILE_RESPONSES)
def get_cloud(scan: Scan, service: Service, if_none_match: IfNoneMatch) -> Response:
    """Return the merged cloud as binary PLY, in metres, in the base frame."""
    return _send(scan, service, CLOUD, PLY, if_none_match, f"{scan.id}.ply")


@router.get("/{id}/height-map", response_model=HeightMapDocument, responses=FILE_RESPONSES)
def get_height_map(scan: Scan, service: Service, if_none_match: IfNoneMatch) -> Response:
    """Return the height of the table and of all that lies on it, in cells of 2 mm.

    A planner uses it to keep its own motions clear of what lies on the table. The grasps keep clear of it already.
    Scans with the finding `no-string-in-view` have no height map.
    """
    etag = f'{tag_of_height_map(scan, service)[:-1]}-json"'
    if matches(if_none_match, etag):
        return not_modified_response(etag)
    return json_response(height_map_document(read_height_map(scan, service)), headers={"ETag": etag})


@router.get("/{id}/height-map.png", response_class=Response, responses=_file("image/png") | FILE_RESPONSES)
async def get_height_map_image(id: Id, service: Service, if_none_match: IfNoneMatch) -> Response:  # noqa: A002 (the path's own name)
    """Return an image of the height map, with one pixel for each cell: x to the right, y up.

    The colours go from blue, 3 mm below the table, to yellow, 27 mm above it. Unmeasured cells are transparent.
    """

    def find() -> tuple[ScanRow, str]:
        scan = find_scan(id, service)
        return scan, tag_of_height_map(scan, service)

    scan, tag = await service.response_cache.get(("height map", id), find)

    def draw() -> bytes:
        return draw_heights(read_height_map(scan, service))

    return await service.image_cache.respond(("height map", id, tag), if_none_match, draw)


@router.get("/{id}/preview.png", response_class=FileResponse, responses=_file("image/png") | FILE_RESPONSES)
async def get_preview(id: Id, service: Service, if_none_match: IfNoneMatch) -> Response:  # noqa: A002 (the path's own name)
    """Return an image of the result from above, with cloud, chains and crossings.

    The image is drawn after the model is ready, so the first request may wait for a moment.
    """
    await _wait_for_preview(id, service)

    def read() -> Response:
        return _send(find_scan(id, service), service, PREVIEW, "image/png", if_none_match)

    return await service.response_cache.respond(("preview", id, if_none_match), read)


@router.get("/{id}/thumbnail.png", response_class=Response, responses=_file("image/png") | FILE_RESPONSES)
async def get_thumbnail(id: Id, service: Service, if_none_match: IfNoneMatch) -> Response:  # noqa: A002 (the path's own name)
    """Return the preview as a small image."""
    await _wait_for_preview(id, service)

    def stat_preview() -> tuple[Path, int, str]:
        scan = find_scan(id, service)
        path = result_path(scan, service, PREVIEW)
        file_stat, etag = stat_file(path, **hash_and_size(scan, PREVIEW))
        return path, file_stat.st_size, etag

    path, size_bytes, etag = await service.response_cache.get(("thumbnail", id), stat_preview)
    return await service.image_cache.respond(
        (id, etag), if_none_match, lambda: shrink_image(read_file(path, size_bytes), THUMBNAIL_WIDTH_PX)
    )


RECORDING: Responses = (
    _file(recordings.MCAP) | NOT_MODIFIED | problem_responses("scan-not-found", "no-result", "invalid-request")
)


@router.get("/{id}/recording", response_class=FileResponse, responses=RECORDING)
def get_scan_recording(scan: Scan, service: Service, if_none_match: IfNoneMatch) -> Response:
    """Return the recording of the scan, in any state of the scan."""
    recording = service.store.recording(scan.recording) if scan.recording else None
    if recording is None:
        raise ProblemError("no-result", f"scan {scan.id} has no recording", scan=scan.id)
    return recordings.send_recording(service, recording, if_none_match, scan.id)


def _model_since(scan: ScanRow, before: ScanRow, service: Context, if_none_match: str | None) -> Response:
    """Return the model of a scan with its changes since another scan, or 304."""
    paths = [result_path(row, service, MODEL) for row in (scan, before)]
    tags = [
        stat_file(path, **hash_and_size(row, MODEL))[1][1:-1] for path, row in zip(paths, (scan, before), strict=True)
    ]
    etag = f'"{tags[0]}-since-{tags[1]}"'
    if matches(if_none_match, etag):
        return not_modified_response(etag)
    (document, model), (_, earlier) = (read_model(path, row) for path, row in zip(paths, (scan, before), strict=True))
    changes = ChangesDocument.of(model.since(earlier), before.id).model_dump(mode="json")
    return JSONResponse(document | {"since": changes}, headers={"etag": etag})


async def _wait_for_preview(scan_id: str, service: Context) -> None:
    """Wait until the preview is drawn, or its drawing has ended or taken too long."""
    deadline = time.monotonic() + PREVIEW_TIMEOUT_S
    while service.jobs.is_drawing(scan_id) and time.monotonic() < deadline:
        await asyncio.sleep(POLL_INTERVAL_S)  # without blocking a thread


def _send(
    scan: ScanRow, service: Context, name: str, media_type: str, if_none_match: str | None, save_as: str | None = None
) -> Response:
    path = result_path(scan, service, name)
    return send_file(path, media_type, if_none_match, save_as=save_as, **hash_and_size(scan, name))
