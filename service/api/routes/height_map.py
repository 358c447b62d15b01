"""Routes of the height map of a scan: its values, and an image."""

import json
from typing import Any

import numpy as np
from fastapi import APIRouter, Response

from service.api.dependencies import Context, Id, Scan, Service, find_scan
from service.api.file_responses import NOT_MODIFIED, IfNoneMatch, matches, not_modified_response, stat_file
from service.api.images.height_colours import colour_heights
from service.api.problem_responses import problem_responses
from service.api.result_files import damaged, hash_and_size, result_path
from service.api.routes.recordings import BINARY
from service.api.schemas.addresses import SCANS
from service.api.schemas.height_map import HeightMapDocument
from service.problems.problem_error import ProblemError
from service.processing.height_map_file import HeightMapError, StoredHeightMap, read_npz
from service.storage.data_folder import HEIGHT_MAP
from service.storage.rows import ScanRow

router = APIRouter(prefix=SCANS, tags=["scans"])

_RESPONSES: dict[int | str, dict[str, Any]] = NOT_MODIFIED | problem_responses(
    "scan-not-found", "no-result", "result-not-ready", "invalid-request"
)
_PNG: dict[int | str, dict[str, Any]] = {200: {"content": {"image/png": BINARY}}}


@router.get("/{id}/height-map", response_model=HeightMapDocument, responses=_RESPONSES)
def get_height_map(scan: Scan, service: Service, if_none_match: IfNoneMatch) -> Response:
    """Return the height of the table and of all that lies on it, in cells of 2 mm.

    A planner uses it to keep its own motions clear of what lies on the table. The grasps keep clear of it already.
    Scans without a string have no height map.
    """
    etag = f'{_tag(scan, service)[:-1]}-json"'
    if matches(if_none_match, etag):
        return not_modified_response(etag)
    stored = read_height_map(scan, service)
    heights = stored.heights
    # to a tenth of a millimetre, of which the table's noise is a multiple
    z_m = (heights.z_m.astype(np.float64).round(4) + 0.0).astype(object)
    z_m[np.isnan(heights.z_m)] = None
    document = {
        "frame": "base",
        "x_m": round(heights.x_m, 6),
        "y_m": round(heights.y_m, 6),
        "cell_m": round(heights.cell_m, 6),
        "table_z_m": round(stored.table_z_m, 6),
        "min_object_height_m": round(stored.min_object_height_m, 6),
        "z_m": z_m.tolist(),
    }
    return Response(json.dumps(document), media_type="application/json", headers={"ETag": etag})


@router.get("/{id}/height-map.png", response_class=Response, responses=_PNG | _RESPONSES)
async def get_height_map_image(id: Id, service: Service, if_none_match: IfNoneMatch) -> Response:  # noqa: A002 (the path's own name)
    """Return an image of the height map, with one pixel for each cell: x to the right, y up.

    The colours go from blue, 3 mm below the table, to yellow, 27 mm above it. Unmeasured cells are transparent.
    """

    def find() -> tuple[ScanRow, str]:
        scan = find_scan(id, service)
        return scan, _tag(scan, service)

    scan, tag = await service.response_cache.get(("height map", id), find)
    draw = lambda: _draw(read_height_map(scan, service))  # noqa: E731
    return await service.image_cache.respond(("height map", id, tag), if_none_match, draw)


def read_height_map(scan: ScanRow, service: Context) -> StoredHeightMap:
    """Return the height map of a scan.

    Raises:
        ProblemError: `no-result`, `result-not-ready`: There is none. `damaged`: Its file cannot be read.
    """
    path = result_path(scan, service, HEIGHT_MAP)
    try:
        return read_npz(path)
    except (HeightMapError, OSError) as error:
        raise damaged(path, scan, error) from error


def _tag(scan: ScanRow, service: Context) -> str:
    """Return the entity tag of the file of a height map.

    Raises:
        ProblemError: `no-result`, `result-not-ready`: There is none. `damaged`: It is gone, or has another size.
    """
    path = result_path(scan, service, HEIGHT_MAP)
    if HEIGHT_MAP not in (scan.files or {}):
        reason = "no string was in view, or an earlier release made the result"
        raise ProblemError("no-result", f"scan {scan.id} has no height map: {reason}", scan=scan.id)
    return stat_file(path, **hash_and_size(scan, HEIGHT_MAP))[1]


def _draw(stored: StoredHeightMap) -> bytes:
    """Return the image of a height map as PNG."""
    import cv2

    height_m = stored.heights.z_m.T[::-1] - stored.table_z_m
    measured = np.isfinite(height_m)
    opacity = np.where(measured, 255, 0).astype(np.uint8)
    image = np.dstack([colour_heights(np.where(measured, height_m, 0.0)), opacity])
    return cv2.imencode(".png", image)[1].tobytes()
