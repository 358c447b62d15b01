"""The camera matrix of depth images: `camera.json`, `K.json`, or four numbers."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibration.atomic_write import TooLargeError, read_limited
from cell.frames.errors import FramesError

CAMERA, MATRIX = "camera.json", "K.json"
MAX_JSON_BYTES = 4 << 20
MEMBERS = {"width", "height", "K", "depth_unit_m", "distortion", "D", "id"}
FORM = '{"width": 640, "height": 400, "K": [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]}'


@dataclass(frozen=True, eq=False)
class Intrinsics:
    """Pinhole camera of rectified depth images."""

    K: NDArray[np.float64]
    """(3, 3), pixels."""
    source: str
    """Where it comes from: a file name, or the option."""
    size: tuple[int, int] | None = None
    """Width and height of its images, pixels; None: not known."""
    depth_unit_m: float | None = None
    """Metres per depth count, where the file has it."""


def read_intrinsics(folder: Path, given: tuple[float, float, float, float] | None) -> Intrinsics:
    """Return the camera matrix `given` as (fx, fy, cx, cy), or else the one of the file in `folder`.

    Raises:
        FramesError: There is no matrix, or two, or it is not that of a rectified pinhole camera.
    """
    if given is not None:
        fx, fy, cx, cy = given
        return Intrinsics(_pinhole([[fx, 0, cx], [0, fy, cy], [0, 0, 1]], "--intrinsics"), "--intrinsics")
    there = [folder / name for name in (CAMERA, MATRIX) if (folder / name).exists()]
    if not there:
        raise FramesError(f"{folder} has no {CAMERA} ({FORM}) and no {MATRIX}: add one, or give --intrinsics")
    if len(there) > 1:
        raise FramesError(f"{folder} has both {CAMERA} and {MATRIX}: keep the one that is right")
    (path,) = there
    document = read_json(path)
    if path.name == MATRIX:
        return Intrinsics(_pinhole(document, str(path)), path.name)
    if not isinstance(document, dict):
        raise FramesError(f"{path} must be an object, as {FORM}")
    missing = [name for name in ("width", "height", "K") if name not in document]
    if missing:
        raise FramesError(f"{path} lacks {', '.join(missing)}: it must be like {FORM}, with the size of its own images")
    unknown = sorted(document.keys() - MEMBERS)
    if unknown:
        raise FramesError(f"{path} has the member {unknown[0]!r}, which is not known here: remove it")
    _refuse_distortion(document, path)
    size = (document["width"], document["height"])
    if not all(isinstance(n, int) and not isinstance(n, bool) and n > 0 for n in size):
        raise FramesError(f"{path}: width and height are {size[0]!r} and {size[1]!r}; whole numbers are needed")
    unit = document.get("depth_unit_m")
    if unit is not None and not _is_number(unit):
        raise FramesError(f"{path}: depth_unit_m is {unit!r}; metres per depth count are needed, as 0.001")
    return Intrinsics(_pinhole(document["K"], str(path)), path.name, size, None if unit is None else float(unit))


def read_json(path: Path) -> Any:
    """Return the document in a JSON file.

    Raises:
        FramesError: The file cannot be read, is too large, or is not JSON.
    """
    try:
        return json.loads(read_limited(path, MAX_JSON_BYTES))
    except (FileNotFoundError, IsADirectoryError, TooLargeError) as error:
        raise FramesError(str(error)) from error
    except OSError as error:
        raise FramesError(f"{path} cannot be read: {error.strerror or error}") from error
    except (ValueError, RecursionError) as error:
        raise FramesError(f"{path} is not JSON: {error}") from error


def _pinhole(value: Any, where: str) -> NDArray[np.float64]:
    """Return K (3, 3), checked."""
    try:
        K = np.array(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        K = np.zeros(0)
    if K.shape != (3, 3) or not np.isfinite(K).all():
        raise FramesError(f"{where}: K must be 3 rows of 3 finite numbers, [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]")
    if not (np.array_equal(K, [(K[0, 0], 0, K[0, 2]), (0, K[1, 1], K[1, 2]), (0, 0, 1)]) and min(K[0, 0], K[1, 1]) > 0):
        raise FramesError(
            f"{where}: K is {K.tolist()}, not a pinhole matrix [[fx, 0, cx], [0, fy, cy], [0, 0, 1]] in pixels "
            "without skew"
        )
    return K


def _refuse_distortion(document: dict[str, Any], path: Path) -> None:
    for name in ("distortion", "D"):
        values = document.get(name) or []
        if not isinstance(values, list) or not all(_is_number(value) for value in values):
            raise FramesError(f"{path}: {name} is {values!r}; a list of numbers is needed")
        if any(values):
            raise FramesError(
                f"{path} has lens distortion ({name}), which is not corrected here: rectify the images by the nearest "
                "pixel, give the K of the rectified images, and remove the coefficients"
            )


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)
