"""Files of solved calibrations are read as they were written, and unusable ones are refused."""

import json
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from calibration.dataset.observations_file import load_observations
from calibration.errors import (
    CalibrationFolderError,
    HandEyeFutureDateError,
    HandEyeInvalidError,
    HandEyeMismatchError,
    HandEyeMissingError,
    HandEyeRefusedError,
    HandEyeStaleError,
)
from calibration.geometry.transforms import from_rotation_vector
from calibration.observations import BoardView, Observations
from calibration.result import Finding, HandEyeResult, ViewReport
from calibration.storage.document import FindingResource
from calibration.storage.hand_eye_file import (
    HandEye,
    activate,
    load_hand_eye,
    previous_path,
    write_hand_eye,
    write_result,
)
from calibration.target.board import Board

NOW = datetime(2026, 3, 1, 12, 0, 0, tzinfo=UTC)
X = from_rotation_vector((0.03, -0.06, 0.05), (0.1, 0.05, 0.4))
Y = from_rotation_vector((0.35, 0.02, 0.003), (3.0, 0.1, 0.2))
K = np.array([[800.25, 0.0, 640.5], [0.0, 801.125, 400.25], [0.0, 0.0, 1.0]])
BOARD = Board()
WARNING = Finding("board-scale-unverified", "the board's size is known to 0.2 % only: add a second distance", False)
REFUSAL = Finding("leave-one-out", "views disagree by 4 mm: find the loose mounting", True)


def as_json(finding: Finding) -> dict[str, Any]:
    """Return a finding as a hand-eye file has it."""
    return FindingResource.model_validate(finding).model_dump()


def covariance() -> np.ndarray:
    """Return a covariance (6, 6) with correlations, for errors of about 0.02 degrees and 0.15 mm."""
    root = np.random.default_rng(5).normal(size=(6, 6)) * np.array([[3e-4] * 3 + [1e-4] * 3]).T
    return root @ root.T


def result(*findings: Finding, **changes: Any) -> HandEyeResult:
    solved = HandEyeResult(
        mounting="eye-in-hand",
        X=X,
        covariance=covariance(),
        Y=Y,
        K=K * np.array([[1.001, 1, 1], [1, 1.001, 1], [1, 1, 1]]),
        board_scale=1.0002,
        board_scale_sigma=0.0004,
        pixel_sigma_px=0.11,
        robot_sigma_m=1.1e-4,
        robot_sigma_rad=3e-4,
        loo_error_m=5e-4,
        repeatability_95_m=7e-4,
        views=(ViewReport("one", True, None, 48, 0.1, 1e-4, 3e-4, 5e-4, 0.4),),
        findings=findings,
        joint_covariance=1e-8 * np.eye(17),
    )
    return replace(solved, **changes)


def seen(*names: str) -> Observations:
    rng = np.random.default_rng(7)
    ids = np.array([0, 3, 4, 11, 12, 30])
    views = tuple(
        BoardView(name, from_rotation_vector(rng.normal(size=3), rng.normal(size=3)), ids, rng.normal(size=(6, 2)))
        for name in names
    )
    return Observations(BOARD, K, (1280, 800), views, camera_id="19443010", robot_serial="20225500123", created=NOW)


def load(path: Path) -> HandEye:
    return load_hand_eye(path, 90.0, NOW + timedelta(days=1))


def written(folder: Path, solved: HandEyeResult, **changes: Any) -> Path:
    """Write the file of a solved calibration with some fields changed, and return its path."""
    path = folder / "hand_eye.json"
    write_result(path, solved, seen("one", "two"))
    path.write_text(json.dumps(json.loads(path.read_text()) | changes))
    return path


def test_a_solved_calibration_is_read_as_it_was_written(tmp_path: Path) -> None:
    path = tmp_path / "hand_eye.json"
    write_result(path, result(), seen("one", "two"))
    got = load(path)
    # Only the conversion of the rotations to unit quaternions rounds.
    np.testing.assert_allclose(got.T_flange_camera, X, rtol=0, atol=1e-15)
    assert got.T_base_board is not None
    np.testing.assert_allclose(got.T_base_board, Y, rtol=0, atol=1e-15)
    assert got.covariance is not None
    np.testing.assert_array_equal(got.covariance, covariance())
    assert got.K is not None
    np.testing.assert_array_equal(got.K, result().K)
    assert (got.board, got.board_scale, got.verdict, got.findings) == (BOARD, 1.0002, "accept", ())
    assert (got.robot_sigma_m, got.robot_sigma_rad, got.repeatability_95_m) == (1.1e-4, 3e-4, 7e-4)
    assert (got.created, got.camera_id, got.robot_serial, got.warnings) == (NOW, "19443010", "20225500123", ())
    assert sorted(file.name for file in tmp_path.iterdir()) == ["hand_eye.json", "observations.json"]


def test_paths_may_be_strings(tmp_path: Path) -> None:
    path, active = str(tmp_path / "hand_eye.json"), str(tmp_path / "active" / "hand_eye.json")
    write_result(path, result(), seen("one", "two"))
    assert load_hand_eye(path, 90.0, NOW).camera_id == "19443010"
    activate(path, active)
    write_hand_eye(path, X, created=NOW)
    activate(path, active)
    assert previous_path(active) == tmp_path / "active" / "hand_eye.previous.json"
    assert previous_path(active).exists()


def test_the_file_has_the_convention_of_the_covariance(tmp_path: Path) -> None:
    document = json.loads(written(tmp_path, result()).read_text())
    assert document["covariance"]["order"] == ["rx", "ry", "rz", "tx", "ty", "tz"]
    assert document["covariance"]["units"] == ["rad"] * 3 + ["m"] * 3
    assert document["covariance"]["convention"].startswith("right, in the camera's frame: X_true = X @ error")
    assert set(document["frames"]) == {"T_flange_camera", "T_base_board"}
    assert document["intrinsics"]["K_given"] == K.tolist()
    assert document["board"]["scale_sigma"] == 0.0004


def test_warnings_are_stored_with_the_calibration(tmp_path: Path) -> None:
    got = load(written(tmp_path, result(WARNING)))
    assert (got.verdict, got.findings) == ("warn", (WARNING,))
    assert WARNING.message in got.warnings


def test_a_refused_calibration_is_written_and_never_loaded(tmp_path: Path) -> None:
    nothing = np.full((4, 4), np.nan)
    path = tmp_path / "hand_eye.json"
    bad = result(WARNING, REFUSAL, X=nothing, covariance=np.full((6, 6), np.nan), repeatability_95_m=float("inf"))
    write_result(path, bad, seen("one"))
    assert json.loads(path.read_text())["T_flange_camera"] is None
    with pytest.raises(HandEyeRefusedError, match=r"was refused when it was solved: views disagree by 4 mm") as refused:
        load(path)
    assert "second distance" not in str(refused.value), "a warning is not the reason of the refusal"
    assert refused.value.slug == "calibration-refused"


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        (
            {"findings": [as_json(WARNING), as_json(REFUSAL)]},
            "views disagree by 4 mm",
        ),
        (
            {"verification": {"passed": False, "message": "the board appears 9 mm off", "views": [{}]}},
            "appears 9 mm off",
        ),
        ({"verdict": "refuse"}, "the file does not say why"),
    ],
)
def test_findings_and_verification_are_checked_beside_the_verdict(
    tmp_path: Path, changes: dict[str, Any], expected: str
) -> None:
    with pytest.raises(HandEyeRefusedError, match=expected):
        load(written(tmp_path, result(), **changes))


def test_an_unverified_calibration_may_be_used(tmp_path: Path) -> None:
    assert load(written(tmp_path, result(), verification={"passed": False, "message": "no view", "views": []}))


def test_a_calibration_is_stale_if_the_limit_is_not_a_number(tmp_path: Path) -> None:
    with pytest.raises(HandEyeStaleError, match=r"is 1\.0 days old"):
        load_hand_eye(written(tmp_path, result()), float("nan"), NOW + timedelta(days=1))


def test_a_fixed_camera_cannot_be_loaded_as_hand_eye(tmp_path: Path) -> None:
    far = from_rotation_vector((1.8, 0.4, 1.2), (2.5, 0, 0))
    path = tmp_path / "hand_eye.json"
    write_result(path, result(mounting="eye-to-hand", X=far), replace(seen("one"), mounting="eye-to-hand"))
    document = json.loads(path.read_text())
    assert document["T_base_camera"]["xyz_m"] == [1.8, 0.4, 1.2]
    assert "T_flange_camera" not in document
    with pytest.raises(HandEyeInvalidError, match="a camera that stands in the cell"):
        load(path)


def changed(matrix: np.ndarray, row: int, column: int, value: float) -> dict[str, Any]:
    matrix = matrix.copy()
    matrix[row, column] = value
    return {"matrix": matrix.tolist()}


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"covariance": changed(covariance(), 0, 1, 1e-3)}, "covariance.matrix: this is not a covariance"),
        ({"covariance": changed(covariance(), 5, 5, -1e-8)}, "symmetric and positive definite"),
        ({"covariance": {"matrix": np.zeros((6, 6)).tolist()}}, "symmetric and positive definite"),
        ({"covariance": {"matrix": np.ones((6, 6)).tolist()}}, "symmetric and positive definite"),
        ({"covariance": changed(covariance(), 2, 2, float("nan"))}, "matrix[2][2] is nan; a finite number is needed"),
        (
            {"covariance": {"matrix": np.eye(3).tolist()}},
            "matrix[0] is [1.0, 0.0, 0.0]; a list of at least 6 is needed",
        ),
        ({"covariance": [[0.0] * 6] * 6}, "an object, {...}, is needed"),
        (
            {"covariance": {"matrix": covariance().tolist(), "order": ["tx", "ty", "tz", "rx", "ry", "rz"]}},
            "covariance: its order is ['tx', 'ty', 'tz', 'rx', 'ry', 'rz']; ['rx', 'ry', 'rz', 'tx', 'ty', 'tz'] is",
        ),
        ({"covariance": {"matrix": covariance().tolist(), "units": ["deg"] * 3 + ["mm"] * 3}}, "its units is"),
        ({"covariance": {"matrix": covariance().tolist(), "convention": "left"}}, "its convention is 'left'"),
        ({"joint_covariance": np.eye(6).tolist()}, "joint_covariance[0] is [1.0, 0.0, "),
        ({"joint_covariance": (np.eye(12) - np.ones((12, 12)) / 10).tolist()}, "not a covariance of 12 or 17 errors"),
        ({"intrinsics": {"K": [[800, 1, 640], [0, 800, 400], [0, 0, 1]]}}, "intrinsics.K: a pinhole matrix"),
        ({"intrinsics": {"K": np.zeros((3, 3)).tolist()}}, "intrinsics.K: a pinhole matrix"),
        ({"verdict": "good"}, "verdict is 'good'"),
        ({"findings": [{"code": "x"}]}, "message is missing"),
        ({"findings": 3}, "findings is 3; a list"),
        ({"findings": ["bad"]}, "findings[0] is 'bad'; an object"),
        ({"T_base_board": np.diag([1.0, 1.0, -1.0, 1.0]).tolist()}, "T_base_board: the transform is mirrored"),
        ({"board": {"kind": "charuco", "columns": 9}}, "the board has no dictionary"),
        ({"board": BOARD.to_json() | {"pitch_m": 25, "scale": 1.0}}, "looks like millimetres"),
        ({"metrics": {"robot_sigma_m": -1.0}}, "robot_sigma_m is -1.0; a number of at least 0 is needed"),
        ({"metrics": {"repeatability_95_m": "1 mm"}}, "repeatability_95_m is '1 mm'; a number is needed"),
        ({"intrinsics": {"K": [1, 2, 3]}}, "K[0] is 1; a list"),
        ({"T_flange_camera": None}, "T_flange_camera"),
    ],
    ids=lambda value: str(value)[-50:],
)
def test_invalid_additional_values_are_refused(tmp_path: Path, changes: dict[str, Any], expected: str) -> None:
    path = written(tmp_path, result(), **changes)
    with pytest.raises(HandEyeInvalidError) as refused:
        load(path)
    assert expected in str(refused.value)
    assert str(path) in str(refused.value)


def test_a_solution_without_a_covariance_is_not_used(tmp_path: Path) -> None:
    with pytest.raises(HandEyeInvalidError, match=r"matrix\[0\]\[0\] is None; a number is needed"):
        load(written(tmp_path, result(covariance=np.full((6, 6), np.inf))))


def test_a_solution_far_from_the_flange_is_not_written(tmp_path: Path) -> None:
    with pytest.raises(HandEyeInvalidError, match="look like millimetres"):
        write_result(tmp_path / "h.json", result(X=from_rotation_vector((57, 0, 0), (0, 0, 0))), seen("one"))
    with pytest.raises(HandEyeInvalidError, match="a time zone is needed"):
        write_result(tmp_path / "h.json", result(), replace(seen("one"), created=NOW.replace(tzinfo=None)))
    assert not list(tmp_path.iterdir())


def test_observations_are_read_exactly(tmp_path: Path) -> None:
    path, given, held_out = tmp_path / "hand_eye.json", seen("one", "two"), seen("three")
    write_result(path, result(), given, held_out)
    kept = load_observations(tmp_path / "observations.json")
    got = kept.observations
    assert [view.name for view in got.views] == ["one", "two"]
    assert (got.board, got.image_size, got.mounting) == (BOARD, (1280, 800), "eye-in-hand")
    assert (got.camera_id, got.robot_serial, got.created) == ("19443010", "20225500123", NOW)
    np.testing.assert_array_equal(got.K, K)
    assert got.distortion.shape == (0,)
    for view, before in zip(got.views, given.views, strict=True):
        assert view.ids.dtype == np.int64
        np.testing.assert_array_equal(view.ids, before.ids)
        np.testing.assert_array_equal(view.pixels, before.pixels)
        np.testing.assert_array_equal(view.T_base_flange, before.T_base_flange)
        assert view.corner_sigma_px is None
    assert [view.name for view in kept.held_out.views] == ["three"]
    assert kept.sha256 == json.loads(path.read_text())["observations_sha256"]


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"ids": [0, 3, 4, 11, 12, len(BOARD.points)]}, "not different corner numbers from 0 to"),
        ({"ids": [0, 3, 4, 11, 12, 12]}, "not different corner numbers"),
        ({"ids": [0, 3, 4, 11, 12, 1.5]}, "ids[5] is 1.5; a whole number is needed"),
        ({"ids": [0]}, "1 ids and 6 pixels"),
        ({"pixels": [[1, 2, 3]]}, "views[0].pixels[0] is [1, 2, 3]; a list of at most 2 is needed"),
        ({"pixels": [[1e999, 0]] * 6}, "a finite number is needed"),
        ({"name": ""}, "name is ''"),
        ({"name": "two"}, "two views named 'two'"),
        ({"held_out": 1}, "true or false is needed"),
        ({"T_base_flange": np.diag([2.0, 2, 2, 1]).tolist()}, "not rigid"),
        ({"corner_sigma_px": "good"}, "corner_sigma_px is 'good'; a number is needed"),
    ],
    ids=lambda value: str(value)[:40],
)
def test_invalid_observations_are_refused(tmp_path: Path, changes: dict[str, Any], expected: str) -> None:
    path = written(tmp_path, result()).with_name("observations.json")
    document = json.loads(path.read_text())
    document["views"][0] |= changes
    path.write_text(json.dumps(document))
    with pytest.raises(CalibrationFolderError) as refused:
        load_observations(path)
    assert expected in str(refused.value)
    assert str(path) in str(refused.value)


def test_missing_observations_are_reported(tmp_path: Path) -> None:
    with pytest.raises(CalibrationFolderError, match=r"there is no .*solve from the images first"):
        load_observations(tmp_path / "observations.json")


def test_an_activation_keeps_the_former_calibration(tmp_path: Path) -> None:
    (tmp_path / "run").mkdir()
    active = tmp_path / "cell" / "hand_eye.json"
    run_file = written(tmp_path / "run", result())
    assert activate(run_file, active).verdict == "accept"
    assert active.read_bytes() == run_file.read_bytes()
    assert [file.name for file in active.parent.iterdir()] == ["hand_eye.json"]
    first = active.read_bytes()
    run_file = written(tmp_path / "run", result(WARNING))
    for _ in range(2):  # a second activation does not lose the former calibration
        activate(run_file, active)
        assert active.read_bytes() == run_file.read_bytes()
        assert (active.parent / "hand_eye.previous.json").read_bytes() == first
    assert load(active).findings == (WARNING,)


def test_an_activation_fails_if_the_former_calibration_cannot_be_kept(tmp_path: Path) -> None:
    (tmp_path / "run").mkdir()
    active = tmp_path / "hand_eye.json"
    write_hand_eye(active, X, created=NOW)
    before = active.read_bytes()
    previous = tmp_path / "hand_eye.previous.json"
    previous.mkdir()
    with pytest.raises(IsADirectoryError) as failed:
        activate(written(tmp_path / "run", result()), active)
    assert failed.value.filename == str(previous)
    assert active.read_bytes() == before


def test_an_unusable_calibration_is_not_activated(tmp_path: Path) -> None:
    (tmp_path / "run").mkdir()
    active = tmp_path / "hand_eye.json"
    write_hand_eye(active, X, created=NOW)
    before = active.read_bytes()
    with pytest.raises(HandEyeRefusedError):
        activate(written(tmp_path / "run", result(REFUSAL)), active)
    with pytest.raises(HandEyeInvalidError):
        activate(written(tmp_path / "run", result(), T_flange_camera=[1, 2]), active)
    with pytest.raises(HandEyeMissingError):
        activate(tmp_path / "run" / "none.json", active)
    with pytest.raises(HandEyeFutureDateError):
        activate(written(tmp_path / "run", result(), created="2999-01-01T00:00:00+00:00"), active)
    with pytest.raises(HandEyeMismatchError, match="made with camera 1944, this is camera 777"):
        activate(written(tmp_path / "run", result(), camera_id="1944"), active, camera_id="777")
    with pytest.raises(HandEyeMismatchError, match="made with robot 2022, this is robot 888"):
        activate(written(tmp_path / "run", result(), robot_serial="2022"), active, robot_serial="888")
    assert active.read_bytes() == before
    assert not (tmp_path / "hand_eye.previous.json").exists()
