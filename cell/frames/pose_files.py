"""Poses of depth images: one `poses.json`, or a file beside each image.

A pose is a 4x4 matrix, `{"xyz_m": [3], "quat_xyzw": [4]}` or `{"xyz_m": [3], "rotvec_rad": [3]}`; metres. It may be in
an object that names it, `{"T_base_camera": ...}` or `{"T_base_flange": ...}`; the name must then be the expected one.
"""

from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from calibration.dataset.forms import Form, Vector3, transform_from_json
from calibration.geometry.transforms import from_rotation_vector, rigid
from cell.frames.camera_file import CAMERA, MATRIX, read_json
from cell.frames.errors import FramesError
from cell.frames.folder import natural_order

PoseName = Literal["T_base_camera", "T_base_flange"]
POSES = "poses.json"
FARTHEST_M = 10.0
"""No camera on an arm is farther from the base frame; larger numbers are millimetres."""
FORMS = 'a 4x4 matrix, {"xyz_m": [3], "quat_xyzw": [4]} or {"xyz_m": [3], "rotvec_rad": [3]} is needed'


class _VectorPose(Form):
    xyz_m: Vector3
    rotvec_rad: Vector3


def read_poses(folder: Path, images: list[Path], name: PoseName) -> tuple[list[NDArray[np.float64]], str]:
    """Return the pose (4, 4) of each image, in their order, and where the poses come from.

    Args:
        folder: The folder with the pose files.
        images: The depth images.
        name: Which poses are expected.

    Raises:
        FramesError: A pose is missing, is given twice or is invalid, or there are more poses than images.
    """
    beside = {path: _beside(folder, path) for path in images}
    some = next((files[0] for files in beside.values() if files), None)
    if (folder / POSES).exists():
        if some is not None:
            raise FramesError(f"{folder} has both {POSES} and {some.name}: keep the poses of one kind")
        return _from_list(folder / POSES, images, name), POSES
    if some is None:
        raise FramesError(
            f"{folder} has no poses: add {POSES}, or a file beside each image, as {images[0].stem}.json or "
            f"{images[0].stem}.txt"
        )
    for path, files in beside.items():
        if not files:
            raise FramesError(f"{path} has no pose: add {path.stem}.json or {path.stem}.txt, or remove the image")
        if len(files) > 1:
            raise FramesError(f"{path} has two poses, {files[0].name} and {files[1].name}: keep the one that is right")
    _refuse_poses_without_image(folder, images, name)
    return [_of_file(files[0], name) for files in beside.values()], "a file for each image"


def parse_pose(value: Any, where: str, name: PoseName) -> NDArray[np.float64]:
    """Return the pose (4, 4) that a JSON value gives.

    Args:
        value: The JSON value.
        where: Where it stands, for messages.
        name: Which pose is expected.

    Raises:
        FramesError: The value is not a rigid transform, or has another name.
    """
    if isinstance(value, dict):
        named = [key for key in value if isinstance(key, str) and key.startswith("T_")]
        if named and named != [name]:
            raise FramesError(f"{where} gives {' and '.join(named)}; {_wanted(name)}")
        value = value[name] if named else value
    try:
        if isinstance(value, dict) and {"quat_xyzw", "rotvec_rad"} <= value.keys():
            raise ValueError("it gives the rotation twice, as quat_xyzw and as rotvec_rad")
        if isinstance(value, dict) and "rotvec_rad" in value:
            vector = _VectorPose.model_validate(value)
            if np.linalg.norm(vector.rotvec_rad) > 2 * np.pi:
                raise ValueError("its rotvec_rad is longer than a turn (2 pi): radians are needed, not degrees")
            T = from_rotation_vector(vector.xyz_m, vector.rotvec_rad)
        else:
            T = rigid(transform_from_json(value), "the pose")
    except ValidationError as error:
        fault = error.errors(include_url=False)[0]
        at = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in fault["loc"]).removeprefix(".")
        raise FramesError(f"{where} is not a pose ({at}: {fault['msg']}): {FORMS}") from error
    except ValueError as error:
        raise FramesError(f"{where} is not a pose: {error}") from error
    far = float(np.linalg.norm(T[:3, 3]))
    if far > FARTHEST_M:
        raise FramesError(
            f"{where} is {far:.4g} m from the base frame, more than {FARTHEST_M:g} m: give poses in metres; these look "
            "like millimetres"
        )
    return T


def _wanted(name: PoseName) -> str:
    if name == "T_base_camera":
        return "T_base_camera, which maps camera points to base, is needed; for flange poses give --hand-eye"
    return "with --hand-eye, T_base_flange is needed; for camera poses omit --hand-eye"


def _beside(folder: Path, image: Path) -> list[Path]:
    files = [folder / f"{image.stem}{suffix}" for suffix in (".json", ".txt")]
    return [path for path in files if path.exists() and path.name not in (CAMERA, MATRIX, POSES)]


def _from_list(path: Path, images: list[Path], name: PoseName) -> list[NDArray[np.float64]]:
    """Return the poses in `poses.json`: a list in the order of the images, or an object by file name."""
    document = read_json(path)
    if isinstance(document, list):
        if len(document) != len(images):
            few = len(document) < len(images)
            what = f"{images[len(document)].name} has no pose" if few else "remove the poses without an image"
            raise FramesError(f"{path} has {len(document)} poses, the folder {len(images)} depth images: {what}")
        return [parse_pose(value, f"{path}: pose {k} ({images[k].name})", name) for k, value in enumerate(document)]
    if not isinstance(document, dict):
        raise FramesError(f"{path} must be a list of poses in the order of the images, or an object by file name")
    by_name = {key: value for key, value in document.items() if key not in ("T_base_camera", "T_base_flange")}
    if len(by_name) < len(document):
        raise FramesError(f"{path} must have the poses by file name, each as {{{name!r}: pose}} or as a bare pose")
    poses, used = [], set()
    for image in images:
        keys = [key for key in (image.name, image.stem) if key in by_name]
        if len(keys) != 1:
            what = f"no pose for {image.name}" if not keys else f"two poses for {image.name}"
            raise FramesError(f"{path} has {what}: give one")
        used.update(keys)
        poses.append(parse_pose(by_name[keys[0]], f"{path}: {keys[0]}", name))
    unused = sorted(by_name.keys() - used)
    if unused:
        raise FramesError(f"{path} has a pose for {unused[0]}, which is no depth image in {path.parent}: remove it")
    return poses


def _of_file(path: Path, name: PoseName) -> NDArray[np.float64]:
    """Return the pose in a file of its own."""
    if path.suffix == ".json":
        return parse_pose(read_json(path), str(path), name)
    try:
        lines = path.read_text().replace(",", " ").splitlines()
        rows = [[float(number) for number in line.split()] for line in lines if line.strip()]
    except OSError as error:
        raise FramesError(f"{path} cannot be read: {error.strerror or error}") from error
    except ValueError as error:
        raise FramesError(f"{path} is not a pose ({error}): 4 rows of 4 numbers are needed") from error
    if [len(row) for row in rows] != [4, 4, 4, 4]:
        raise FramesError(f"{path} is not a pose: 4 rows of 4 numbers are needed")
    return parse_pose(rows, str(path), name)


def _refuse_poses_without_image(folder: Path, images: list[Path], name: PoseName) -> None:
    """Refuse files that hold a pose, but belong to no image: an image may have been lost."""
    stems = {image.stem for image in images}
    for path in sorted(folder.iterdir(), key=natural_order):
        if path.suffix not in (".json", ".txt") or path.stem in stems or path.name in (CAMERA, MATRIX, POSES):
            continue
        try:
            _of_file(path, name)
        except FramesError:
            continue  # something else
        raise FramesError(f"{path} holds a pose, and there is no depth image {path.stem}: remove it, or add the image")
