"""Read and write a calibration folder: images of the board, and the flange pose of each image.

    DIR/setup.json   board, camera and robot, as in `calibration.dataset.setup`
    DIR/NAME.png     image of the board (also .jpg, .jpeg, .bmp, .tif, .tiff; grey or colour)
    DIR/NAME.json    flange pose: {"T_base_flange": {"xyz_m": [3], "quat_xyzw": [4]}, "held_out": false}

`T_base_flange` may also be a 4x4 matrix, or `{"xyz_m": [3], "rotvec_rad": [3]}` with a rotation vector. Views with
`held_out` true are used for verification only. The solver adds `observations.json` and `hand_eye.json` to the folder.
The images and poses in DIR must not be symbolic links.
"""

import os
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import PlainValidator

from calibration.atomic_write import read_calibration_file, replace_synced
from calibration.dataset.forms import (
    Form,
    FormT,
    Vector3,
    document_to_bytes,
    parse_form,
    transform_from_json,
    transform_to_json,
)
from calibration.dataset.observations_file import MAX_VIEWS, OBSERVATIONS_FILE
from calibration.dataset.setup import Setup, SetupForm, setup_to_json
from calibration.errors import CalibrationFolderError, HandEyeError, HandEyeInputError
from calibration.geometry.transforms import rigid
from calibration.input_checks.observations import check_in_metres, pose_from_vector

__all__ = [
    "HAND_EYE_FILE",
    "SETUP_FILE",
    "FolderContent",
    "FolderView",
    "read_folder",
    "read_setup",
    "write_setup",
    "write_view",
]

SETUP_FILE = "setup.json"
"""Name of the file with the board, the camera and the robot."""
HAND_EYE_FILE = "hand_eye.json"
"""Name of the file with the solved calibration."""
RESERVED_FILES = {SETUP_FILE, HAND_EYE_FILE, OBSERVATIONS_FILE, "hand_eye.previous.json"}
"""JSON files that are not the pose of a view."""
IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff")
"""Suffixes of image files, in lower case."""
MAX_JSON_BYTES = 1 << 20
"""Maximum size of a JSON file, bytes."""
WRITTEN_NAME = re.compile(r"[0-9A-Za-z][0-9A-Za-z._-]{0,99}")
"""Pattern of the view names that `write_view` accepts. `read_folder` accepts any name."""
UNIT_SLUGS = ("degrees", "millimetres")
"""Slugs of unit errors. A wrong unit in one view means that all poses were written in this unit."""


class _VectorPose(Form):
    xyz_m: Vector3
    rotvec_rad: Vector3


def _parse_pose(value: object) -> NDArray[np.float64] | _VectorPose:
    if isinstance(value, dict) and {"quat_xyzw", "rotvec_rad"} <= value.keys():
        raise ValueError("the rotation is given twice, as quat_xyzw and as rotvec_rad: keep one of them")
    if isinstance(value, dict) and "rotvec_rad" in value:
        return _VectorPose.model_validate(value)
    return transform_from_json(value)


class _ViewForm(Form, extra="forbid"):
    T_base_flange: Annotated[NDArray[np.float64] | _VectorPose, PlainValidator(_parse_pose)]
    held_out: bool = False


@dataclass(frozen=True, eq=False)
class FolderView:
    """One image file and its flange pose."""

    name: str
    """Name of the image file and the pose file, without suffix."""
    image: Path
    """Path of the image file."""
    T_base_flange: NDArray[np.float64]
    """(4, 4) flange pose in the base frame, reported by the robot, metres."""
    held_out: bool
    """Whether the view is used for verification only."""


@dataclass(frozen=True, eq=False)
class FolderContent:
    """The content of a calibration folder."""

    setup: Setup
    """Board, camera and robot."""
    views: tuple[FolderView, ...]
    """Usable views, sorted by name. Numbers in names are sorted by value."""
    excluded: tuple[tuple[str, str], ...]
    """(name, reason) of each view or file that cannot be used."""


def read_folder(folder: str | os.PathLike[str]) -> FolderContent:
    """Read the setup and the flange poses of a calibration folder, and list the images.

    A view with an error is excluded, and the result gives the reason. The images are not opened.

    Args:
        folder: The folder with `setup.json`.

    Raises:
        CalibrationFolderError: The folder is missing, `setup.json` is not valid, or no view is usable.
        HandEyeInputError: A pose is in other units. `slug` is "degrees" or "millimetres".
    """
    folder = Path(folder)
    setup = read_setup(folder)
    images, poses, excluded = _list_files(folder)
    views: list[FolderView] = []
    for name in sorted(images.keys() | poses.keys(), key=_natural_key):
        try:
            views.append(_read_view(name, images.get(name, []), poses.get(name)))
        except HandEyeInputError as error:
            if error.slug in UNIT_SLUGS:
                raise
            excluded.append((name, str(error)))
        except HandEyeError as error:
            excluded.append((name, str(error)))
    if not views:
        example = ""
        if excluded:
            name, reason = excluded[0]
            example = f"; {name}: {reason}"
        raise CalibrationFolderError(
            f"{folder} has no usable view: each view needs an image and a JSON file with T_base_flange, for example "
            f"01.png and 01.json{example}"
        )
    return FolderContent(setup, tuple(views), tuple(excluded))


def read_setup(folder: str | os.PathLike[str]) -> Setup:
    """Read `setup.json` of a calibration folder.

    Raises:
        CalibrationFolderError: The folder is missing, or `setup.json` is not valid.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise CalibrationFolderError(f"{folder} is not a folder: give the folder with {SETUP_FILE} and the images")
    remedy = "write the board, the camera matrix K and the image size to it"
    return _read_form(SetupForm, folder / SETUP_FILE, remedy).to_setup()


def write_setup(folder: str | os.PathLike[str], setup: Setup) -> None:
    """Write `setup.json`. Create the folder if it does not exist.

    Raises:
        OSError: The folder cannot be created, or the file cannot be written.
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    replace_synced(folder / SETUP_FILE, document_to_bytes(setup_to_json(setup)))


def write_view(
    folder: str | os.PathLike[str],
    name: str,
    image: NDArray[np.uint8],
    T_base_flange: NDArray[np.float64],
    held_out: bool = False,
) -> None:
    """Write the PNG file and the pose file of a view, and sync the files to the disk.

    Args:
        folder: The calibration folder.
        name: Name of the two files, without suffix.
        image: (H, W) grey or (H, W, 3) BGR image.
        T_base_flange: (4, 4) flange pose in the base frame, reported by the robot, metres.
        held_out: Whether the view is used for verification only.

    Raises:
        CalibrationFolderError: The name is not valid.
        NotRigidError: The pose is not a rigid transform.
        OSError: A file cannot be written.
    """
    import cv2

    folder = Path(folder)
    if not WRITTEN_NAME.fullmatch(name) or f"{name}.json" in RESERVED_FILES:
        raise CalibrationFolderError(f"a view cannot be named {name[:100]!r}: use letters, digits, ., _ and -")
    pose = transform_to_json(rigid(T_base_flange, f"{name}: T_base_flange"))
    written, png = cv2.imencode(".png", image)
    assert written
    replace_synced(folder / f"{name}.png", png.tobytes())
    replace_synced(folder / f"{name}.json", document_to_bytes({"T_base_flange": pose, "held_out": held_out}))


def _list_files(folder: Path) -> tuple[dict[str, list[Path]], dict[str, Path], list[tuple[str, str]]]:
    """Return the image files by view name, the pose file by view name, and (name, reason) of each excluded file."""
    images: dict[str, list[Path]] = {}
    poses: dict[str, Path] = {}
    excluded = []
    try:
        files = sorted(path for path in folder.iterdir() if not path.name.startswith("."))
        for path in files:
            suffix = path.suffix.lower()
            if path.name in RESERVED_FILES or suffix not in (*IMAGE_SUFFIXES, ".json"):
                continue
            if path.is_symlink():
                excluded.append((path.name, "it is a link, and links are not followed: copy the file to the folder"))
            elif suffix == ".json":
                poses[path.stem] = path
            else:
                images.setdefault(path.stem, []).append(path)
    except OSError as error:
        raise CalibrationFolderError(f"{folder} cannot be read: {error.strerror}") from error
    if len(images) > MAX_VIEWS:
        raise CalibrationFolderError(f"{folder} has {len(images)} images, more than {MAX_VIEWS}: remove some")
    return images, poses, excluded


def _read_view(name: str, images: list[Path], pose: Path | None) -> FolderView:
    if pose is None:
        raise CalibrationFolderError(f"there is no {name}.json with the flange pose of {images[0].name}: add it")
    if not images:
        raise CalibrationFolderError(f"there is no image for {pose.name}: add the image {name}.png")
    if len(images) > 1:
        both = " and ".join(path.name for path in images)
        raise CalibrationFolderError(f"{both} have the same name: keep the image of {pose.name} and remove the other")
    form = _read_form(_ViewForm, pose, "write the flange pose to it")
    T_base_flange = form.T_base_flange
    source = f"{pose}: T_base_flange"
    if isinstance(T_base_flange, _VectorPose):
        T_base_flange = pose_from_vector(T_base_flange.xyz_m, T_base_flange.rotvec_rad, source)
    check_in_metres(T_base_flange[:3, 3], source)
    return FolderView(name, images[0], T_base_flange, form.held_out)


def _read_form(form: type[FormT], path: Path, remedy: str) -> FormT:
    return parse_form(form, read_calibration_file(path, MAX_JSON_BYTES, remedy), path, CalibrationFolderError)


def _natural_key(name: str) -> list[tuple[int, int, str]]:
    """Return a sort key that compares numbers in a name by value, for example 2 before 10."""
    return [_natural_key_of_part(part) for part in re.split(r"(\d+)", name)]


def _natural_key_of_part(part: str) -> tuple[int, int, str]:
    if part.isascii() and part.isdigit():
        return 0, int(part), ""
    return 1, 0, part
