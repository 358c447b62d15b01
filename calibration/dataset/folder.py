"""The folder form of a calibration: images, and where the robot was at each; to solve from, here or from elsewhere.

    DIR/setup.json   board, camera and robot, as in `calibration.dataset.setup`
    DIR/NAME.png     a picture of the board (also .jpg, .jpeg, .bmp, .tif, .tiff; grey or colour) ...
    DIR/NAME.json    ... and where the robot was: {"T_base_flange": {"xyz_m": [3], "quat_xyzw": [4]}, "held_out": false}

`T_base_flange` may also be `{"xyz_m": [3], "rotvec_rad": [3]}`, the rotation as an axis times an angle, or a 4x4
matrix. Views that are `held_out` are not solved from, but verified by. After solving, `observations.json` and
`hand_eye.json` lie there too. Nothing outside DIR is read, links are not followed.
"""

import json
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import PlainValidator

from calibration.dataset.atomic_write import read_in_folder, replace_synced
from calibration.dataset.forms import AnyForm, Form, Numbers3, read_form, to_transform, transform_document
from calibration.dataset.observations_file import MOST_VIEWS, OBSERVATIONS
from calibration.dataset.setup import Setup, SetupForm, setup_document
from calibration.errors import CalibrationFolderError, HandEyeError, HandEyeInputError
from calibration.geometry.transforms import rigid
from calibration.input_checks.observations import check_near, pose_from_vector

__all__ = ["HAND_EYE", "SETUP", "FolderContent", "FolderView", "read_folder", "read_setup", "write_setup", "write_view"]

SETUP, HAND_EYE = "setup.json", "hand_eye.json"
NO_VIEWS = {SETUP, HAND_EYE, OBSERVATIONS, "hand_eye.previous.json"}
IMAGES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff")
LARGEST_JSON_BYTES = 1 << 20
NAME = re.compile(r"[0-9A-Za-z][0-9A-Za-z._-]{0,99}")
"""Of a view that is written: good in any file system. Views that are read may be named as they like."""
UNITS = ("degrees", "millimetres")
"""Faults of one view that are faults of all: whoever wrote the poses took other units."""


class _VectorPose(Form):
    xyz_m: Numbers3
    rotvec_rad: Numbers3


def _to_pose(value: object) -> NDArray[np.float64] | _VectorPose:
    if isinstance(value, dict) and {"quat_xyzw", "rotvec_rad"} <= value.keys():
        raise ValueError("it gives the rotation twice, as quat_xyzw and as rotvec_rad: give the one that holds")
    if isinstance(value, dict) and "rotvec_rad" in value:
        return _VectorPose.model_validate(value)
    return to_transform(value)


class _ViewForm(Form, extra="forbid"):
    T_base_flange: Annotated[NDArray[np.float64] | _VectorPose, PlainValidator(_to_pose)]
    held_out: bool = False


@dataclass(frozen=True, eq=False)
class FolderView:
    """One image and its pose."""

    name: str
    image: Path
    """Not opened yet."""
    T_base_flange: NDArray[np.float64]
    """(4, 4) as the robot told it."""
    held_out: bool


@dataclass(frozen=True, eq=False)
class FolderContent:
    """What a folder holds."""

    setup: Setup
    views: tuple[FolderView, ...]
    """In the order of their names, numbers in them by their value."""
    left_out: tuple[tuple[str, str], ...]
    """Views that cannot be used: name and reason."""


def read_folder(folder: Path) -> FolderContent:
    """The setup, the poses and which images there are; a view with a fault is left out and named.

    Raises:
        CalibrationFolderError: no such folder, no usable `setup.json`, no view that can be used.
        HandEyeInputError: poses in "degrees" or "millimetres".
    """
    setup = read_setup(folder)
    images, poses, left_out = _files(folder)
    views: list[FolderView] = []
    for name in sorted(images.keys() | poses.keys(), key=_in_order):
        try:
            views.append(_view(name, images.get(name, []), poses.get(name), folder))
        except HandEyeInputError as error:
            if error.slug in UNITS:
                raise
            left_out.append((name, str(error)))
        except HandEyeError as error:
            left_out.append((name, str(error)))
    if not views:
        why = f"; {left_out[0][0]}: {left_out[0][1]}" if left_out else ""
        raise CalibrationFolderError(
            f"{folder} holds no view that can be used: images and a JSON file with T_base_flange beside each are "
            f"needed, as 01.png and 01.json{why}"
        )
    return FolderContent(setup, tuple(views), tuple(left_out))


def read_setup(folder: Path) -> Setup:
    """The `setup.json` of a folder. Raises CalibrationFolderError."""
    if not folder.is_dir():
        raise CalibrationFolderError(f"{folder} is not a folder: name the one that holds {SETUP} and the images")
    return _read(SetupForm, folder / SETUP, "it tells the board, the camera's matrix K and the image size").setup()


def write_setup(folder: Path, setup: Setup) -> None:
    """Makes the folder if need be, and writes its `setup.json`. Raises OSError."""
    folder.mkdir(parents=True, exist_ok=True)
    replace_synced(folder / SETUP, _json(setup_document(setup)))


def write_view(
    folder: Path, name: str, image: NDArray[np.uint8], T_base_flange: NDArray[np.float64], held_out: bool = False
) -> None:
    """Writes a picture (H, W) or (H, W, 3), BGR, as PNG and where the robot was; both are on the disk on return.

    Raises:
        CalibrationFolderError: a name that is no file's.
        NotRigidError: T_base_flange (4, 4).
        OSError: a file cannot be written.
    """
    import cv2

    if not NAME.fullmatch(name) or f"{name}.json" in NO_VIEWS:
        raise CalibrationFolderError(f"a view cannot be named {name[:100]!r}: letters, digits, . _ and - are possible")
    pose = transform_document(rigid(T_base_flange, f"{name}: T_base_flange"))
    written, png = cv2.imencode(".png", image)
    assert written
    replace_synced(folder / f"{name}.png", png.tobytes())
    replace_synced(folder / f"{name}.json", _json({"T_base_flange": pose, "held_out": held_out}))


def _files(folder: Path) -> tuple[dict[str, list[Path]], dict[str, Path], list[tuple[str, str]]]:
    """Images and poses by the view's name, and what is left out."""
    images: dict[str, list[Path]] = {}
    poses: dict[str, Path] = {}
    left_out = []
    try:
        files = sorted(path for path in folder.iterdir() if not path.name.startswith("."))
        for path in files:
            suffix = path.suffix.lower()
            if path.name in NO_VIEWS or suffix not in (*IMAGES, ".json"):
                continue
            if path.is_symlink():
                left_out.append((path.name, "it is a link, which is not followed: copy the file here"))
            elif suffix == ".json":
                poses[path.stem] = path
            else:
                images.setdefault(path.stem, []).append(path)
    except OSError as error:
        raise CalibrationFolderError(f"{folder} cannot be read: {error.strerror}") from error
    if len(images) > MOST_VIEWS:
        raise CalibrationFolderError(f"{folder} holds {len(images)} images; up to {MOST_VIEWS} are taken")
    return images, poses, left_out


def _view(name: str, images: list[Path], pose: Path | None, folder: Path) -> FolderView:
    if pose is None:
        raise CalibrationFolderError(f"there is no {name}.json with the robot's pose beside {images[0].name}")
    if not images:
        raise CalibrationFolderError(f"there is no image beside {pose.name}: a picture {name}.png is needed")
    if len(images) > 1:
        both = " and ".join(path.name for path in images)
        raise CalibrationFolderError(f"{both} have the same name: which of them belongs to {pose.name} is not known")
    form = _read(_ViewForm, pose, "it tells where the robot was")
    T_base_flange = form.T_base_flange
    where = f"{pose}: T_base_flange"
    if isinstance(T_base_flange, _VectorPose):
        T_base_flange = pose_from_vector(T_base_flange.xyz_m, T_base_flange.rotvec_rad, where)
    check_near(T_base_flange[:3, 3], where)
    return FolderView(name, images[0], T_base_flange, form.held_out)


def _read(form: type[AnyForm], path: Path, tells: str) -> AnyForm:
    return read_form(form, read_in_folder(path, LARGEST_JSON_BYTES, tells), path, CalibrationFolderError)


def _json(document: object) -> bytes:
    return (json.dumps(document, indent=2, allow_nan=False) + "\n").encode()


def _in_order(name: str) -> list[tuple[int, int, str]]:
    """2 before 10, whatever stands around the numbers."""
    parts = re.split(r"(\d+)", name)
    return [(0, int(part), "") if part.isascii() and part.isdigit() else (1, 0, part) for part in parts]
