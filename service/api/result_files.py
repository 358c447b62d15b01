"""Files of the result of a scan, for the routes that send them or answer from them."""

import json
from pathlib import Path
from typing import Any

from recognition.errors import ModelError
from recognition.model.model import PointChainModel
from service.api.dependencies import Context
from service.api.file_responses import stat_file
from service.problems.problem_error import ProblemError
from service.processing.height_map_file import HeightMapError, StoredHeightMap, read_npz
from service.states import ACTIVE_STATES, RESULT_STATES
from service.storage.data_folder import HEIGHT_MAP, open_file
from service.storage.rows import ScanRow


def result_path(scan: ScanRow, service: Context, name: str) -> Path:
    """Return the path of a result.

    Raises:
        OutsideError: There is a link in place of the result.
        ProblemError: `result-not-ready`: The scan has not ended. `no-result`: The scan has no result.
    """
    if scan.state in ACTIVE_STATES:
        raise ProblemError(
            "result-not-ready", f"scan {scan.id} is {scan.state}; wait for its end", scan=scan.id, state=scan.state
        )
    if scan.state not in RESULT_STATES:
        raise ProblemError(
            "no-result", f"scan {scan.id} is {scan.state}: it has no result", scan=scan.id, state=scan.state
        )
    return service.store.folder.result(scan.id, name)


def hash_and_size(scan: ScanRow, name: str) -> dict[str, Any]:
    """Return hash and size of a file of a result, or nothing if they are not recorded."""
    return (scan.files or {}).get(name, {})


def read_model(path: Path, scan: ScanRow) -> tuple[dict[str, Any], PointChainModel]:
    """Return the document of a model, and the model.

    Raises:
        ProblemError: `damaged`: The file is not a model.
    """
    try:
        with open_file(path) as file:
            document = json.load(file)
        return document, PointChainModel.from_json(document)
    except (ModelError, ValueError, OSError) as error:
        raise damaged(path, scan, error) from error


def damaged(path: Path, scan: ScanRow, error: Exception) -> ProblemError:
    """Return the problem of a file of a result that cannot be used."""
    message = f"{path.name} of scan {scan.id} cannot be read ({error}): run `pointchain doctor`"
    return ProblemError("damaged", message, file=path.name)


def tag_of_height_map(scan: ScanRow, service: Context) -> str:
    """Return the entity tag of the file of a height map.

    Raises:
        ProblemError: `no-result`, `result-not-ready`: There is none. `damaged`: It is gone, or has another size.
    """
    path = result_path(scan, service, HEIGHT_MAP)
    if HEIGHT_MAP not in (scan.files or {}):
        raise ProblemError(
            "no-result", f"scan {scan.id} has no height map, because no string was in view", scan=scan.id
        )
    return stat_file(path, **hash_and_size(scan, HEIGHT_MAP))[1]


def read_height_map(scan: ScanRow, service: Context) -> StoredHeightMap:
    """Return the height map of a scan.

    Raises:
        ProblemError: `no-result`, `result-not-ready`: There is none. `damaged`: Its file cannot be read.
    """
    path = result_path(scan, service, HEIGHT_MAP)
    try:
        with open_file(path) as file:
            return read_npz(file)
    except (HeightMapError, OSError) as error:
        raise damaged(path, scan, error) from error
