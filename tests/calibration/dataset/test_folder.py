"""Calibration folders are read as they were written, and every error names its file."""

import json
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from calibration.atomic_write import read_limited, sync_folder, write_synced
from calibration.dataset.folder import read_folder, read_setup, write_setup, write_view
from calibration.dataset.observations_file import load_observations, write_observations
from calibration.dataset.setup import Setup
from calibration.dataset.view_detection import read_image
from calibration.errors import CalibrationFolderError, HandEyeInputError
from calibration.geometry.transforms import NotRigidError, from_rotation_vector
from calibration.target.board import Board

K = np.array([[402.0, 0.0, 319.5], [0.0, 402.0, 199.5], [0.0, 0.0, 1.0]])
TAKEN = datetime(2026, 1, 31, 12, 0, 30, tzinfo=UTC)
SETUP = Setup(Board(), K, (640, 400), camera_id="19443010", robot_serial="20225500123", created=TAKEN)
POSE = from_rotation_vector((0.4, 0.1, 0.5), (2.2, -2.0, 0.3))
GREY = np.full((400, 640), 127, dtype=np.uint8)


def make_folder(folder: Path, *names: str) -> Path:
    """Make a calibration folder with these views, all equal."""
    write_setup(folder, SETUP)
    for name in names:
        write_view(folder, name, GREY, POSE)
    return folder


def test_a_folder_is_read_as_it_was_written(tmp_path: Path) -> None:
    folder = make_folder(tmp_path / "runs" / "a", "10", "9")
    colour = np.random.default_rng(1).integers(0, 255, (400, 640, 3), dtype=np.uint8)
    write_view(folder, "verify", colour, POSE, held_out=True)
    content = read_folder(folder)
    assert (content.setup.board, content.setup.image_size) == (Board(), (640, 400))
    assert (content.setup.camera_id, content.setup.robot_serial) == ("19443010", "20225500123")
    assert (content.setup.mounting, content.setup.created, content.excluded) == ("eye-in-hand", TAKEN, ())
    np.testing.assert_array_equal(content.setup.K, K)
    assert [(view.name, view.held_out) for view in content.views] == [("9", False), ("10", False), ("verify", True)]
    for view in content.views:
        # Only the conversion of the rotation to a unit quaternion rounds.
        np.testing.assert_allclose(view.T_base_flange, POSE, rtol=0, atol=1e-15)
    np.testing.assert_array_equal(cv2.imread(str(content.views[2].image)), colour)
    assert not [path for path in folder.iterdir() if path.name.startswith(".")], "no temporary file is left"


def test_paths_may_be_strings(tmp_path: Path) -> None:
    folder = str(tmp_path / "run")
    write_setup(folder, SETUP)
    write_view(folder, "a", GREY, POSE)
    (view,) = read_folder(folder).views
    assert read_setup(folder).board == Board()
    assert read_image(str(view.image), (640, 400)).shape == GREY.shape
    path = f"{folder}/observations.json"
    sha256 = write_observations(path, SETUP.observations(()))
    assert load_observations(path).sha256 == sha256
    write_synced(f"{folder}/new", b"1")
    sync_folder(folder)
    assert read_limited(f"{folder}/new", 1) == b"1"


@pytest.mark.parametrize(
    "pose",
    [
        {"xyz_m": POSE[:3, 3].tolist(), "rotvec_rad": [2.2, -2.0, 0.3]},
        POSE.tolist(),
    ],
)
def test_poses_may_be_rotation_vectors_or_matrices(tmp_path: Path, pose: Any) -> None:
    folder = make_folder(tmp_path, "a")
    (folder / "a.json").write_text(json.dumps({"T_base_flange": pose}))
    (view,) = read_folder(folder).views
    np.testing.assert_allclose(view.T_base_flange, POSE, rtol=0, atol=1e-12)
    assert not view.held_out


def test_other_files_are_not_views(tmp_path: Path) -> None:
    folder = make_folder(tmp_path, "a")
    for name in ("hand_eye.json", "observations.json", "hand_eye.previous.json", ".hidden.json", "notes.txt"):
        (folder / name).write_text("not read")
    (folder / "pictures").mkdir()
    content = read_folder(folder)
    assert ([view.name for view in content.views], content.excluded) == (["a"], ())


def pose(folder: Path, value: Any) -> None:
    (folder / "b.json").write_text(json.dumps({"T_base_flange": value}))


def without(path: str) -> Callable[[Path], None]:
    return lambda folder: (folder / path).unlink()


def of(value: Any) -> Callable[[Path], None]:
    return lambda folder: pose(folder, value)


def linked(folder: Path) -> None:
    (folder / "b.png").rename(folder.parent / "outside.png")
    (folder / "b.png").symlink_to(folder.parent / "outside.png")


@pytest.mark.parametrize(
    ("spoil", "expected"),
    [
        (without("b.json"), "there is no b.json with the flange pose of b.png"),
        (without("b.png"), "there is no image for b.json"),
        (lambda folder: (folder / "b.JPG").write_bytes(b"x"), "b.JPG and b.png have the same name"),
        (lambda folder: (folder / "b.json").write_bytes(b"{"), "b.json is not JSON"),
        (lambda folder: (folder / "b.json").write_bytes(b"[" * 100_000), "b.json is not JSON"),
        (lambda folder: (folder / "b.json").write_bytes(b" " * (2 << 20)), "b.json has more than 1 MiB"),
        (lambda folder: (folder / "b.json").write_text("3"), "b.json is not a JSON object"),
        (lambda folder: (folder / "b.json").write_text("{}"), "T_base_flange is missing"),
        (lambda folder: [(folder / "b.json").unlink(), (folder / "b.json").mkdir()], "b.json is not a file"),
        (of(None), "b.json: T_base_flange: a 4x4 matrix or"),
        (of({"xyz_m": [0, 0, 0]}), "quat_xyzw is missing"),
        (of({"xyz_m": [0, 0, 0], "quat_xyzw": [0, 0, 0, 1], "rotvec_rad": [0, 0, 1]}), "the rotation is given twice"),
        (of({"xyz_m": [0, 0], "rotvec_rad": [0, 0, 0]}), "xyz_m is [0, 0]; a list of at least 3 is needed"),
        (of({"xyz_m": [0, 0, 0], "rotvec_rad": ["a", 0, 0]}), "rotvec_rad[0] is 'a'; a number is needed"),
        (of({"xyz_m": [0, 0, 0], "quat_xyzw": [0, 0, 0, 2]}), "quaternion of length 2"),
        (of(np.diag([1.0, 1.0, -1.0, 1.0]).tolist()), "mirrored"),
        (of((1.3 * POSE).tolist()), "b.json: T_base_flange: the transform has the last row"),
        (of([[float("nan")] * 4] * 4), "b.json: T_base_flange[0][0] is nan; a finite number"),
        (of({"xyz_m": [float("inf"), 0, 0], "rotvec_rad": [0, 0, 0]}), "xyz_m[0] is inf; a finite number is needed"),
        (
            lambda folder: (folder / "b.json").write_text(
                json.dumps({"T_base_flange": POSE.tolist(), "held_out": "no"})
            ),
            "held_out is 'no'; true or false is needed",
        ),
        (
            lambda folder: (folder / "b.json").write_text(
                json.dumps({"T_base_flange": POSE.tolist(), "heldout": True})
            ),
            "heldout is unknown",
        ),
        (linked, "it is a link"),
    ],
)
def test_a_view_with_an_error_is_excluded_and_named(
    tmp_path: Path, spoil: Callable[[Path], object], expected: str
) -> None:
    folder = make_folder(tmp_path / "folder", "a", "b", "c")
    spoil(folder)
    content = read_folder(folder)
    assert [view.name for view in content.views] == ["a", "c"]
    assert {name.split(".")[0] for name, _ in content.excluded} == {"b"}
    assert expected in "; ".join(reason for _, reason in content.excluded)


@pytest.mark.parametrize(
    ("value", "slug"),
    [
        ({"xyz_m": [0.4, 0.1, 0.5], "rotvec_rad": [126.0, -114.6, 17.2]}, "degrees"),
        ({"xyz_m": [400.0, 100.0, 500.0], "rotvec_rad": [2.2, -2.0, 0.3]}, "millimetres"),
        ({"xyz_m": [0.0, 0.0, 1000.0], "quat_xyzw": [0.0, 0.0, 0.0, 1.0]}, "millimetres"),
        ([[1.0, 0, 0, 400], [0, 1, 0, 100], [0, 0, 1, 500], [0, 0, 0, 1]], "millimetres"),
    ],
)
def test_a_wrong_unit_rejects_the_whole_folder(tmp_path: Path, value: Any, slug: str) -> None:
    folder = make_folder(tmp_path, "a", "b")
    pose(folder, value)
    with pytest.raises(HandEyeInputError, match=r"b\.json") as refused:
        read_folder(folder)
    assert refused.value.slug == slug


def change(part: str | None, **changes: Any) -> Callable[[dict[str, Any]], object]:
    return lambda document: (document if part is None else document[part]).update(changes)


@pytest.mark.parametrize(
    ("spoil", "expected"),
    [
        (change(None, schema_version=2), "schema_version is 2; 1 is needed"),
        (change(None, board=None), "the board is 'None': an object"),
        (change("board", columns=0), "columns"),
        (change("board", pitch_m=25), "looks like millimetres"),
        (change("board", pitch_m=10**400), "a number of metres is needed"),
        (change("board", dictionary=[]), "OpenCV has no dictionary '[]'"),
        (change(None, camera=[]), "camera is []; an object"),
        (change("camera", width=0), "camera.width is 0; a number of at least 1 is needed"),
        (change("camera", width=10**9), "a number of at most 16384 is needed"),
        (change("camera", height=400.5), "height is 400.5; a whole number is needed"),
        (change("camera", height=True), "height is True; a whole number is needed"),
        (change("camera", K=[[1, 2], [3, 4]]), "K[0] is [1, 2]; a list of at least 3 is needed"),
        (change("camera", K=np.eye(3).T.tolist()[::-1]), "a pinhole matrix"),
        (change("camera", K=[[800, 2, 640], [0, 800, 400], [0, 0, 1]]), "skew is not supported"),
        (change("camera", K=[[800, 0, 640], [2, 800, 400], [0, 0, 1]]), "a pinhole matrix"),
        (change("camera", K=(K * float("nan")).tolist()), "camera.K[0][0] is nan; a finite number is needed"),
        (
            change("camera", distortion=[0.1, 0.2]),
            "distortion: there are 2 coefficients; OpenCV needs 0, 4, 5, 8, 12 or 14",
        ),
        (change("camera", id=7), "camera.id is 7; text is needed"),
        (change(None, robot_serial=""), "robot_serial is ''"),
        (change(None, mounting="on the flange"), "'eye-in-hand' or 'eye-to-hand' is needed"),
        (change(None, robot="20225500123"), "robot is unknown"),
        (change(None, created="2026-01-31T12:00:00"), "created: '2026-01-31T12:00:00' has no time zone"),
        (change(None, created="yesterday"), "created: 'yesterday' is not a time"),
        (change("camera", distorsion=[0.1] * 5), "camera.distorsion is unknown"),
        (lambda document: document.pop("camera"), "camera is missing"),
        (lambda document: document["camera"].pop("K"), "K is missing"),
    ],
)
def test_an_invalid_setup_is_rejected(tmp_path: Path, spoil: Callable[[dict[str, Any]], object], expected: str) -> None:
    path = make_folder(tmp_path, "a") / "setup.json"
    document = json.loads(path.read_text())
    spoil(document)
    path.write_text(json.dumps(document))
    with pytest.raises(CalibrationFolderError) as refused:
        read_folder(tmp_path)
    assert expected in str(refused.value)
    assert str(path) in str(refused.value)


def test_folders_without_views_are_rejected(tmp_path: Path) -> None:
    with pytest.raises(CalibrationFolderError, match="is not a folder"):
        read_folder(tmp_path / "none")
    with pytest.raises(CalibrationFolderError, match=r"there is no .*setup\.json: write the board"):
        read_folder(tmp_path)
    write_setup(tmp_path, SETUP)
    with pytest.raises(CalibrationFolderError, match="has no usable view: each view needs an image and a JSON file"):
        read_folder(tmp_path)
    (tmp_path / "a.png").write_bytes(b"")
    with pytest.raises(CalibrationFolderError, match=r"a: there is no a\.json with the flange pose"):
        read_folder(tmp_path)


def test_nothing_invalid_is_written(tmp_path: Path) -> None:
    write_setup(tmp_path, SETUP)
    for name in ("", "../a", "a/b", ".a", "setup", "hand_eye", "observations", "a" * 101):
        with pytest.raises(CalibrationFolderError, match="cannot be named"):
            write_view(tmp_path, name, GREY, POSE)
    with pytest.raises(NotRigidError):
        write_view(tmp_path, "a", GREY, 2 * POSE)
    assert [path.name for path in tmp_path.iterdir()] == ["setup.json"]
