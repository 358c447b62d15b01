"""What the camera saw from each viewpoint of a scan, also while it is under way."""

from pathlib import Path
from typing import Annotated, Any

from fastapi import APIRouter, Response
from fastapi import Path as InPath

from cell.recording.view_reader import read_poses, read_view
from service.api.dependencies import Context, Id, Service, find_scan
from service.api.depth_image import draw_depth
from service.api.file_responses import NOT_MODIFIED, IfNoneMatch
from service.api.problem_responses import RECORDING, problem_responses
from service.api.response_cache import json_answer
from service.api.routes.recordings import BINARY, require_whole
from service.api.schemas.addresses import SCANS
from service.api.schemas.base import Described
from service.problems.problem_error import ProblemError

router = APIRouter(prefix=SCANS, tags=["scans"])

_REFUSALS = ("scan-not-found", "no-result", "invalid-request", *RECORDING)

Matrix = list[list[float]]


class SeenView(Described):
    """A view that was taken."""

    index: int
    T_base_camera: Matrix
    K: Matrix
    width: int
    height: int
    picture: str
    """Address of its depth image, coloured by height above the table."""


class SeenViews(Described):
    """The views of a scan, by their indices."""

    views: list[SeenView]


@router.get("/{id}/views", response_model=SeenViews, responses=problem_responses(*_REFUSALS))
async def get_views(id: Id, service: Service) -> Response:  # noqa: A002 (the path's own name)
    """From where each view was taken: as many as there are by now."""

    def read() -> Response:
        path = _recording(id, service)
        views = [
            SeenView(
                index=pose.index,
                T_base_camera=pose.T_base_camera.tolist(),
                K=pose.K.tolist(),
                width=pose.width,
                height=pose.height,
                picture=f"{SCANS}/{id}/views/{pose.index}.png",
            )
            for pose in ([] if path is None else read_poses(path))
        ]
        return json_answer(SeenViews(views=views))

    return await service.reading.answer(("views", id), read)


Index = Annotated[int, InPath(ge=0, le=999)]
PNG: dict[int | str, dict[str, Any]] = {200: {"content": {"image/png": BINARY}}} | NOT_MODIFIED


@router.get("/{id}/views/{index}.png", response_class=Response, responses=PNG | problem_responses(*_REFUSALS))
async def get_view_picture(id: Id, index: Index, service: Service, has: IfNoneMatch) -> Response:  # noqa: A002
    """What was measured from a viewpoint, coloured by height above the table: from 3 mm below it, blue, to 27 mm above,
    yellow; black where nothing was measured. Cut to the workspace."""
    path = await service.reading.known(("recording of", id), lambda: _recording(id, service))

    def draw() -> bytes:
        seen = None if path is None else read_view(path, index)
        if seen is None:
            raise ProblemError("no-result", f"scan {id} has no view {index}, or not yet")
        return draw_depth(*seen)

    return await service.pictures.answer((path, index), has, draw)


def _recording(scan_id: str, service: Context) -> Path | None:
    """The file with the scan's views: of a live one under way the one that is being written. None: nothing is in it
    yet.

    Raises:
        ProblemError: 404, there is no such scan, or it has no recording; `damaged`, as `present`.
    """
    scan = find_scan(scan_id, service)
    recording = service.store.recording(scan.recording) if scan.recording else None
    if recording is not None:
        require_whole(service, recording)
        return service.store.folder.recording(recording.id)
    if scan.mode != "live":
        raise ProblemError("no-result", f"scan {scan_id} has no recording")
    path = service.store.folder.recording(scan_id)
    return path if path.is_file() and path.stat().st_size > 0 else None
