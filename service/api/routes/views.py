"""Routes of the views of a scan, also while it is running."""

from pathlib import Path
from typing import Annotated, Any

from fastapi import APIRouter, Response
from fastapi import Path as InPath

from cell.recording.view_reader import read_poses, read_view
from service.api.dependencies import Context, Id, Service, find_scan
from service.api.file_responses import NOT_MODIFIED, IfNoneMatch
from service.api.images.depth_image import draw_depth
from service.api.problem_responses import RECORDING, problem_responses
from service.api.response_cache import json_response
from service.api.routes.recordings import BINARY, require_recording_file
from service.api.schemas.addresses import SCANS
from service.api.schemas.base import ApiModel
from service.problems.problem_error import ProblemError

router = APIRouter(prefix=SCANS, tags=["scans"])

_PROBLEMS = ("scan-not-found", "no-result", "invalid-request", *RECORDING)

Matrix = list[list[float]]


class ViewResource(ApiModel):
    """A captured view."""

    index: int
    T_base_camera: Matrix
    K: Matrix
    width: int
    height: int
    image: str
    """Address of the depth image, coloured by height above the table."""


class ViewList(ApiModel):
    """The views of a scan, in the order of their indices."""

    views: list[ViewResource]


@router.get("/{id}/views", response_model=ViewList, responses=problem_responses(*_PROBLEMS))
async def get_views(id: Id, service: Service) -> Response:  # noqa: A002 (the path's own name)
    """Return the camera pose of each view that is captured so far."""

    def read() -> Response:
        path = _recording(id, service)
        views = [
            ViewResource(
                index=pose.index,
                T_base_camera=pose.T_base_camera.tolist(),
                K=pose.K.tolist(),
                width=pose.width,
                height=pose.height,
                image=f"{SCANS}/{id}/views/{pose.index}.png",
            )
            for pose in ([] if path is None else read_poses(path))
        ]
        return json_response(ViewList(views=views))

    return await service.response_cache.respond(("views", id), read)


Index = Annotated[int, InPath(ge=0, le=999)]
PNG: dict[int | str, dict[str, Any]] = {200: {"content": {"image/png": BINARY}}} | NOT_MODIFIED


@router.get("/{id}/views/{index}.png", response_class=Response, responses=PNG | problem_responses(*_PROBLEMS))
async def get_view_image(id: Id, index: Index, service: Service, if_none_match: IfNoneMatch) -> Response:  # noqa: A002
    """Return the depth image of a view, coloured by height above the table and cropped to the workspace.

    The colours go from blue, 3 mm below the table, to yellow, 27 mm above it. Unmeasured pixels are black.
    """
    path = await service.response_cache.get(("recording of", id), lambda: _recording(id, service))

    def draw() -> bytes:
        view_and_header = None if path is None else read_view(path, index)
        if view_and_header is None:
            raise ProblemError("no-result", f"scan {id} has no view {index}, or not yet", scan=id, view=index)
        return draw_depth(*view_and_header)

    return await service.image_cache.respond((path, index), if_none_match, draw)


def _recording(scan_id: str, service: Context) -> Path | None:
    """Return the file with the scan's views, or None if it has no data yet.

    For a running live scan, this is the file that is being written.

    Raises:
        ProblemError: `scan-not-found`: There is no such scan. `no-result`: The scan has no recording. `damaged`: As for
            `require_recording_file`.
    """
    scan = find_scan(scan_id, service)
    recording = service.store.recording(scan.recording) if scan.recording else None
    if recording is not None:
        require_recording_file(service, recording)
        return service.store.folder.recording(recording.id)
    if scan.mode != "live":
        raise ProblemError("no-result", f"scan {scan_id} has no recording", scan=scan_id)
    path = service.store.folder.recording(scan_id)
    return path if path.is_file() and path.stat().st_size > 0 else None
