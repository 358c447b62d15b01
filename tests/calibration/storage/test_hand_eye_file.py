"""Hand-eye files: reading, writing, and the errors of invalid files."""

import hashlib
import json
from datetime import UTC, datetime, timedelta, timezone
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calibration.errors import (
    HandEyeError,
    HandEyeFutureDateError,
    HandEyeInvalidError,
    HandEyeMismatchError,
    HandEyeMissingError,
    HandEyeStaleError,
    HandEyeUnreadableError,
)
from calibration.geometry.transforms import NotRigidError, from_rotation_vector
from calibration.storage.hand_eye_file import HandEye, load_hand_eye, require_match, write_hand_eye

NOW = datetime(2026, 3, 1, 12, 0, 0, tzinfo=UTC)
T = from_rotation_vector((0.03, -0.06, 0.05), (0.1, 0.05, 0.4))
NAN = float("nan")


def load(path: Path, days: float = 90.0) -> HandEye:
    return load_hand_eye(path, days, NOW)


def written(folder: Path, **changes: Any) -> Path:
    """Write a valid file with some fields changed, and return its path. Fields that are `...` are omitted."""
    path = folder / "hand_eye.json"
    write_hand_eye(path, T, created=NOW - timedelta(days=10), camera_id="19443010", robot_serial="20225500123")
    document = json.loads(path.read_text()) | changes
    path.write_text(json.dumps({key: value for key, value in document.items() if value is not ...}))
    return path


def test_a_file_is_read_as_it_was_written(tmp_path: Path) -> None:
    path = tmp_path / "hand_eye.json"
    write_hand_eye(path, T, created=NOW, camera_id="19443010", robot_serial="20225500123")
    got = load(path)
    # Only the conversion of the rotation to a unit quaternion rounds.
    np.testing.assert_allclose(got.T_flange_camera, T, rtol=0, atol=1e-15)
    assert (got.created, got.camera_id, got.robot_serial) == (NOW, "19443010", "20225500123")
    assert got.sha256 == hashlib.sha256(path.read_bytes()).hexdigest()
    assert got.warnings == ()
    assert [file.name for file in tmp_path.iterdir()] == ["hand_eye.json"], "no temporary file is left"


@given(st.lists(st.floats(-0.5, 0.5), min_size=3, max_size=3), st.lists(st.floats(-3.1, 3.1), min_size=3, max_size=3))
def test_any_mounting_is_read_as_it_was_written(
    tmp_path_factory: pytest.TempPathFactory, xyz: list[float], turn: list[float]
) -> None:
    path = tmp_path_factory.mktemp("any") / "hand_eye.json"
    mounting = from_rotation_vector(xyz, turn)
    write_hand_eye(path, mounting, created=NOW)
    # A few rounding errors of entries of size 1.
    np.testing.assert_allclose(load(path).T_flange_camera, mounting, rtol=0, atol=2e-15)


def test_a_file_is_replaced_and_its_hash_changes(tmp_path: Path) -> None:
    path = tmp_path / "hand_eye.json"
    write_hand_eye(path, T, created=NOW)
    before = load(path)
    write_hand_eye(path, np.eye(4), created=NOW)
    assert load(path).sha256 != before.sha256


def test_a_file_of_a_recording_is_read_with_warnings(tmp_path: Path) -> None:
    path = tmp_path / "hand_eye.json"
    path.write_text(json.dumps({"T_flange_camera": T.tolist()}))
    got = load(path)
    np.testing.assert_array_equal(got.T_flange_camera, T)
    assert (got.created, got.camera_id, got.robot_serial) == (None, None, None)
    assert [warning.split("does not say ")[1].split(" ")[0] for warning in got.warnings] == ["when", "of", "of"]


@pytest.mark.parametrize("decimals", [4, 5, 6])
def test_a_rounded_matrix_gives_an_exact_rotation(tmp_path: Path, decimals: int) -> None:
    path = written(tmp_path, T_flange_camera=T.round(decimals).tolist(), T_base_board=T.round(decimals).tolist())
    got = load(path)
    assert got.T_base_board is not None
    for pose in (got.T_flange_camera, got.T_base_board):
        np.testing.assert_allclose(pose[:3, :3].T @ pose[:3, :3], np.eye(3), rtol=0, atol=1e-14)
        np.testing.assert_allclose(pose, T, rtol=0, atol=2 * 10.0**-decimals)
    assert got.sha256 == hashlib.sha256(path.read_bytes()).hexdigest()


@pytest.mark.parametrize(("degrees", "warned"), [(0, False), (90, False), (95, False), (110, True), (180, True)])
def test_a_camera_that_looks_back_at_the_arm_is_a_warning(tmp_path: Path, degrees: float, warned: bool) -> None:
    path = tmp_path / "hand_eye.json"
    write_hand_eye(path, from_rotation_vector((0, 0, 0.05), (np.deg2rad(degrees), 0, 0)), created=NOW)
    warnings = [warning for warning in load(path).warnings if "looks back at the arm" in warning]
    assert len(warnings) == warned
    assert all(f"{degrees} degrees from the flange's z" in text and "x, y, z, w" in text for text in warnings)


def test_a_quaternion_with_its_real_part_first_is_a_warning(tmp_path: Path) -> None:
    wrong = {"xyz_m": [0.0, 0.0, 0.05], "quat_xyzw": [1.0, 0.0, 0.0, 0.0]}
    assert "180 degrees" in load(written(tmp_path, T_flange_camera=wrong)).warnings[0]


def test_additional_fields_are_ignored(tmp_path: Path) -> None:
    got = load(written(tmp_path, made_by="another tool", residuals=[[0.0] * 6] * 6))
    assert got.camera_id == "19443010"


def test_the_age_accounts_for_time_zones(tmp_path: Path) -> None:
    path = tmp_path / "hand_eye.json"
    write_hand_eye(path, T, created=(NOW - timedelta(days=2)).astimezone(timezone(timedelta(hours=-7))))
    assert load(path, 2.0).created == NOW - timedelta(days=2)
    with pytest.raises(HandEyeStaleError, match=r"is 2\.0 days old, and hand_eye\.max_age_days is 1\.9: calibrate"):
        load(path, 1.9)


def test_the_age_is_by_the_clock_by_default(tmp_path: Path) -> None:
    path = tmp_path / "hand_eye.json"
    write_hand_eye(path, T, created=datetime.now(UTC) - timedelta(days=3))
    assert load_hand_eye(path, 4.0).created is not None
    with pytest.raises(HandEyeStaleError, match=r"3\.0 days old"):
        load_hand_eye(path, 2.0)


def test_a_date_may_be_one_day_in_the_future(tmp_path: Path) -> None:
    path = tmp_path / "hand_eye.json"
    write_hand_eye(path, T, created=NOW + timedelta(days=1))
    assert load(path).created is not None
    write_hand_eye(path, T, created=NOW + timedelta(days=2))
    with pytest.raises(HandEyeFutureDateError, match="2026-03-03T12:00:00"):
        load(path)


def moved(metres: float) -> dict[str, list[float]]:
    return {"xyz_m": [0.0, 0.0, metres], "quat_xyzw": [0.0, 0.0, 0.0, 1.0]}


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"schema_version": 2}, "schema_version is 2; 1 is needed"),
        ({"T_flange_camera": ...}, "T_flange_camera is missing"),
        ({"T_flange_camera": {"xyz_m": [0, 0, 0]}}, "quat_xyzw is missing"),
        (
            {"T_flange_camera": {"xyz_m": [0, 0], "quat_xyzw": [0, 0, 0, 1]}},
            "T_flange_camera.xyz_m is [0, 0]; a list of at least 3 is needed",
        ),
        (
            {"T_flange_camera": {"xyz_m": [0, 0, 0, 0], "quat_xyzw": [0, 0, 0, 1]}},
            "xyz_m is [0, 0, 0, 0]; a list of at most 3 is needed",
        ),
        (
            {"T_flange_camera": {"xyz_m": [0, 0, 0], "quat_xyzw": [0, 0, 1]}},
            "quat_xyzw is [0, 0, 1]; a list of at least 4 is needed",
        ),
        (
            {"T_flange_camera": {"xyz_m": ["a", 0, 0], "quat_xyzw": [0, 0, 0, 1]}},
            "xyz_m[0] is 'a'; a number is needed",
        ),
        ({"T_flange_camera": {"xyz_m": [[], 0, 0], "quat_xyzw": [0, 0, 0, 1]}}, "a number is needed"),
        ({"T_flange_camera": {"xyz_m": [0, 0, 0], "quat_xyzw": [0, 0, 0, True]}}, "a number is needed"),
        ({"T_flange_camera": {"xyz_m": [0, 0, 0], "quat_xyzw": [0, 0, 0, "1"]}}, "a number is needed"),
        ({"T_flange_camera": np.eye(4).astype(str).tolist()}, "T_flange_camera[0][0] is '1.0'; a number is needed"),
        ({"T_flange_camera": {"xyz_m": [NAN, 0, 0], "quat_xyzw": [0, 0, 0, 1]}}, "a finite number is needed"),
        ({"T_flange_camera": {"xyz_m": [0, 0, 0], "quat_xyzw": [0, 0, 0, 2]}}, "quaternion of length 2"),
        ({"T_flange_camera": {"xyz_m": [0, 0, 0], "quat_xyzw": [0, 0, 0, 0]}}, "quaternion of length 0"),
        ({"T_flange_camera": {"xyz_m": [10**400, 0, 0], "quat_xyzw": [0, 0, 0, 1]}}, "a number is needed"),
        ({"T_flange_camera": np.diag([1.0, 1.0, -1.0, 1.0]).tolist()}, "mirrored"),
        ({"T_flange_camera": np.diag([1.1, 1.1, 1.1, 1.0]).tolist()}, "not rigid"),
        ({"T_flange_camera": "identity"}, "T_flange_camera: a 4x4 matrix or"),
        ({"T_flange_camera": None}, "T_flange_camera: a 4x4 matrix or"),
        ({"T_flange_camera": moved(65.0)}, "65 m from the flange, and at most 1 m is accepted: give metres; these"),
        ({"T_flange_camera": from_rotation_vector((30, -60, 50), (0, 0, 0)).tolist()}, "look like millimetres"),
        ({"created": "yesterday"}, "created: 'yesterday' is not a time; write it as"),
        ({"created": 1767225600}, "created: '1767225600' is not a time; write it as"),
        ({"created": "2026-02-01T12:00:00"}, "has no time zone"),
        ({"camera_id": 19443010}, "camera_id is 19443010; text is needed"),
        ({"robot_serial": ""}, "robot_serial is ''"),
    ],
    ids=lambda value: str(value)[:50],
)
def test_an_invalid_file_is_refused(tmp_path: Path, changes: dict[str, Any], expected: str) -> None:
    path = written(tmp_path, **changes)
    with pytest.raises(HandEyeInvalidError) as refused:
        load(path)
    assert expected in str(refused.value)
    assert str(path) in str(refused.value)


@pytest.mark.parametrize("content", [b"", b"\xff\xfe", b"{", b"[1, 2]", b"3", b"[" * 100_000])
def test_a_file_that_is_not_a_json_object_is_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "hand_eye.json"
    path.write_bytes(content)
    with pytest.raises(HandEyeInvalidError, match="is not"):
        load(path)


def test_a_missing_file_is_reported(tmp_path: Path) -> None:
    with pytest.raises(HandEyeMissingError, match=r"no hand-eye calibration .*none\.json: calibrate, or set"):
        load(tmp_path / "none.json")


def test_a_folder_and_a_huge_file_are_refused(tmp_path: Path) -> None:
    with pytest.raises(HandEyeUnreadableError, match="is not a file"):
        load(tmp_path)
    huge = tmp_path / "huge.json"
    with huge.open("wb") as file:
        file.truncate(17 << 20)
    with pytest.raises(HandEyeUnreadableError, match="more than 16 MiB"):
        load(huge)


def test_every_error_has_a_slug_of_the_calibration() -> None:
    slugs = [error.slug for error in HandEyeError.__subclasses__()]
    slugs.remove("calibration")  # errors of inputs, each of which has its own slug
    assert len(set(slugs)) == len(slugs) >= 8
    assert all(slug.startswith("calibration-") for slug in slugs)


def test_a_calibration_of_another_camera_or_robot_is_refused(tmp_path: Path) -> None:
    hand_eye = load(written(tmp_path))
    require_match(hand_eye, "19443010", "20225500123")
    with pytest.raises(HandEyeMismatchError, match="made with camera 19443010, this is camera 777"):
        require_match(hand_eye, "777", "20225500123")
    with pytest.raises(HandEyeMismatchError, match="made with robot 20225500123, this is robot 888"):
        require_match(hand_eye, "19443010", "888")


def test_unknown_ids_are_not_compared(tmp_path: Path) -> None:
    require_match(load(written(tmp_path, camera_id=None, robot_serial=...)), "777", "888")
    require_match(load(written(tmp_path)), None, None)


def test_an_invalid_pose_is_not_written(tmp_path: Path) -> None:
    path = tmp_path / "hand_eye.json"
    with pytest.raises(NotRigidError):
        write_hand_eye(path, 2 * np.eye(4), created=NOW)
    with pytest.raises(HandEyeInvalidError, match="millimetres"):
        write_hand_eye(path, from_rotation_vector((30, 0, 0), (0, 0, 0)), created=NOW)
    with pytest.raises(HandEyeInvalidError, match="a time zone is needed"):
        write_hand_eye(path, T, created=NOW.replace(tzinfo=None))
    with pytest.raises(FileNotFoundError):
        write_hand_eye(tmp_path / "none" / "hand_eye.json", T, created=NOW)
    assert list(tmp_path.iterdir()) == []
