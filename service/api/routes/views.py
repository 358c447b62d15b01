"""Routes of the views of a scan and of its plan, also while it is running."""

from pathlib import Path
from typing import Annotated, Any

from fastapi import APIRouter, Response
from fastapi import Path as InPath
from fastapi.responses import JSONResponse

from cell.devices import View
from cell.recording.header import RecordingHeader
from cell.recording.view_reader import read_poses, read_view
from service.api.dependencies import Context, Id, Service, find_scan
from service.api.file_responses import NOT_MODIFIED, IfNoneMatch
from service.api.images.depth_image import draw_depth
from service.api.images.view_points import view_points
from service.api.problem_responses import RECORDING, problem_responses
from service.api.response_cache import json_response
from service.api.routes.recordings import BINARY, require_recording_file
from service.api.schemas.addresses import SCANS
from service.api.schemas.base import ApiModel
from service.api.schemas.viewpoint_plan import PlanDocument
from service.problems.problem_error import ProblemError
from service.processing.results import to_ply

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
    cloud: str
    """Address of the points as a PLY file."""


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
                cloud=f"{SCANS}/{id}/views/{pose.index}.ply",
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
    path = await _recording_path(id, service)
    return await service.image_cache.respond(
        ("image", path, index), if_none_match, lambda: draw_depth(*_read_view(path, id, index))
    )


PLY: dict[int | str, dict[str, Any]] = {200: {"content": {"application/octet-stream": BINARY}}} | NOT_MODIFIED


@router.get("/{id}/views/{index}.ply", response_class=Response, responses=PLY | problem_responses(*_PROBLEMS))
async def get_view_cloud(id: Id, index: Index, service: Service, if_none_match: IfNoneMatch) -> Response:  # noqa: A002
    """Return the points of a view in the workspace as a binary PLY file, metres, base frame, for drawing.

    The points are as captured, before registration. At most 10,000 are returned; those that stand above the table
    come first.
    """
    path = await _recording_path(id, service)
    return await service.image_cache.respond(
        ("cloud", path, index),
        if_none_match,
        lambda: to_ply(view_points(*_read_view(path, id, index))),
        media_type="application/octet-stream",
    )


@router.get("/{id}/plan", response_model=PlanDocument, responses=problem_responses(*_PROBLEMS))
async def get_plan(id: Id, service: Service) -> Response:  # noqa: A002
    """Return the plan of the last live scan: its viewpoints and the path of the arm.

    A live scan has its plan from the state `preflight` on, until the next one is planned or the service ends.
    """

    def read() -> Response:
        find_scan(id, service)
        plan = service.jobs.plan_of(id)
        if plan is None:
            raise ProblemError("no-result", f"scan {id} has no plan; only the last live scan has one", scan=id)
        return JSONResponse(plan.to_json())

    return await service.response_cache.respond(("plan", id), read)


async def _recording_path(scan_id: str, service: Context) -> Path | None:
    return await service.response_cache.get(("recording of", scan_id), lambda: _recording(scan_id, service))


def _read_view(path: Path | None, scan_id: str, index: int) -> tuple[View, RecordingHeader]:
    found = None if path is None else read_view(path, index)
    if found is None:
        raise ProblemError("no-result", f"scan {scan_id} has no view {index}, or not yet", scan=scan_id, view=index)
    return found


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
