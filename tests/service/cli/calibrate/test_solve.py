"""`pointchain calibrate solve` and `activate` on rendered images, with a known camera pose."""

import json
import shutil
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from calibration.dataset.observations_file import write_observations
from calibration.errors import HandEyeStaleError
from calibration.geometry.transforms import from_rotation_vector
from calibration.storage.hand_eye_file import load_hand_eye
from service.cli.calibrate.activate import activation_command
from service.cli.main import main
from tests.calibration.board_views import error_of, record
from tests.calibration.rendered_folder import X, rendered_folder

REAL_CELL = "[arm]\nkind = 'ur'\nhost = '10.0.0.1'\n[camera]\nkind = 'oak'\n"
"""A cell whose configuration has no device id and no serial number."""


@pytest.fixture(scope="module")
def taken(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with twelve views, and two more held out. Tests must not change it."""
    return rendered_folder(tmp_path_factory.mktemp("taken") / "images")


@pytest.fixture
def folder(taken: Path, tmp_path: Path) -> Path:
    """Return a copy of that folder."""
    return Path(shutil.copytree(taken, tmp_path / "run"))


@pytest.fixture(scope="module")
def solved_once(taken: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a solved copy of that folder without the images. Tests must not change it."""
    folder = Path(shutil.copytree(taken, tmp_path_factory.mktemp("solved") / "run"))
    assert main(["calibrate", "solve", str(folder)]) == 0
    for image in folder.glob("*.png"):
        image.unlink()
    return folder


@pytest.fixture
def solved(solved_once: Path, tmp_path: Path) -> Path:
    """Return a copy of the solved folder."""
    return Path(shutil.copytree(solved_once, tmp_path / "solved"))


def calibrate(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, str, str]:
    """Return the exit code, stdout and stderr."""
    code = main(["calibrate", *(str(argument) for argument in arguments)])
    out, err = capsys.readouterr()
    return code, out, err


def change_poses(folder: Path, change: Any) -> None:
    for path in folder.glob("[0-9]*.json"):
        document = json.loads(path.read_text())
        document["T_base_flange"] = change(document["T_base_flange"])
        path.write_text(json.dumps(document))


def test_a_folder_can_be_solved_again(capsys: pytest.CaptureFixture[str], folder: Path) -> None:
    (folder / "03.png").write_bytes(b"spoilt")
    code, out, err = calibrate(capsys, "solve", folder)
    assert code == 0, out
    assert out.startswith("Verdict         accept")
    assert "Uncertainty" in out
    assert "Repeatability" in out
    assert "Leave-one-out" in out
    assert "Verified        the board appears where it lay" in out
    assert "Unusable        03: " in out
    assert "01: 48 of 48 corners" in err
    assert (
        f"to activate it: pointchain calibrate activate {folder / 'hand_eye.json'}, with the --config of the cell"
        in err
    )
    solved = load_hand_eye(folder / "hand_eye.json", 1.0)
    degrees, millimetres = error_of(solved.T_flange_camera, X)
    # three standard deviations for eleven views by a robot with errors of 0.1 mm and 0.02 degrees along each axis
    assert degrees < 0.06
    assert millimetres < 0.7
    assert (solved.camera_id, solved.robot_serial, solved.verdict) == ("19443010", "20225500123", "accept")
    for image in folder.glob("*.png"):
        image.unlink()
    code, out, err = calibrate(capsys, "solve", folder, "--again", "--json", "--out", folder / "again.json")
    assert code == 0, err
    again = load_hand_eye(folder / "again.json", 1.0)
    np.testing.assert_array_equal(again.T_flange_camera, solved.T_flange_camera)
    assert solved.covariance is not None
    assert again.covariance is not None
    np.testing.assert_array_equal(again.covariance, solved.covariance)
    document = json.loads(out)
    assert document["verdict"] == "accept"
    assert len(document["views"]) == 11
    assert document["verification"]["passed"] is True
    assert document == json.loads((folder / "again.json").read_text()) | {"unseen": []}


def test_the_calibration_is_as_old_as_its_images(
    capsys: pytest.CaptureFixture[str], folder: Path, tmp_path: Path
) -> None:
    setup = json.loads((folder / "setup.json").read_text())
    taken = datetime.now(UTC).replace(microsecond=0) - timedelta(days=100)
    (folder / "setup.json").write_text(json.dumps(setup | {"created": taken.isoformat()}))
    for again in ((), ("--again",)):
        code, _, err = calibrate(capsys, "solve", folder, *again)
        assert code == 0, err
        assert load_hand_eye(folder / "hand_eye.json", 101.0).created == taken
        with pytest.raises(HandEyeStaleError):
            load_hand_eye(folder / "hand_eye.json", 99.0)
    document = json.loads((folder / "observations.json").read_text())
    del document["created"]
    (folder / "observations.json").write_text(json.dumps(document))
    code, _, err = calibrate(capsys, "solve", folder, "--again")
    assert code == 0, err
    solved = load_hand_eye(folder / "hand_eye.json", 1.0)
    assert solved.created is None
    assert "does not say when it was made" in solved.warnings[0]


@pytest.mark.parametrize("held_out", [True, False], ids=["without the board", "none"])
def test_an_unverified_result_has_a_warning(capsys: pytest.CaptureFixture[str], folder: Path, held_out: bool) -> None:
    for name in ("13", "14"):
        if held_out:
            cv2.imwrite(str(folder / f"{name}.png"), np.full((400, 640), 120, dtype=np.uint8))
        else:
            (folder / f"{name}.png").unlink()
            (folder / f"{name}.json").unlink()
    for again in ((), ("--again",)):
        code, out, err = calibrate(capsys, "solve", folder, *again)
        assert code == 0, err
        assert out.startswith("Verdict         warn")
        assert "so the calibration is not verified" in " ".join(out.split())
        assert "Not verified    there is no view of the board besides those that the calibration was solved from" in out
        assert "were held out" not in out + err
        assert '"held_out": true' in err
        document = json.loads((folder / "hand_eye.json").read_text())
        assert [finding["code"] for finding in document["findings"]] == ["not-verified"]


def test_json_lists_the_unusable_views(capsys: pytest.CaptureFixture[str], folder: Path) -> None:
    (folder / "02.json").unlink()
    code, out, err = calibrate(capsys, "solve", folder, "--json")
    assert code == 0, err
    document = json.loads(out)
    assert [view["name"] for view in document["unseen"]] == ["02"]
    assert "no 02.json" in document["unseen"][0]["reason"]
    assert "02: excluded" in err
    assert document["T_flange_camera"]["xyz_m"] == pytest.approx(X[:3, 3], abs=7e-4)


def test_changed_observations_are_reported(capsys: pytest.CaptureFixture[str], solved: Path) -> None:
    path = solved / "observations.json"
    document = json.loads(path.read_text())
    document["views"][0]["name"] = "first"
    path.write_text(json.dumps(document))
    code, _, err = calibrate(capsys, "solve", solved, "--again")
    assert code == 0
    assert "hand_eye.json was not solved from this observations.json" in err
    code, _, err = calibrate(capsys, "solve", solved, "--again")
    assert "was not solved from" not in err


def test_a_refused_result_is_written_and_cannot_be_activated(
    capsys: pytest.CaptureFixture[str], solved: Path, tmp_path: Path
) -> None:
    # the poses of the first half have another tool frame
    tool = from_rotation_vector((0.02, 0.0, 0.03), (0.0, 0.3, 0.0))
    path = solved / "observations.json"
    document = json.loads(path.read_text())
    for view in document["views"][:6]:
        view["T_base_flange"] = (np.array(view["T_base_flange"]) @ tool).tolist()
    path.write_text(json.dumps(document))
    code, out, _ = calibrate(capsys, "solve", solved, "--again")
    assert code == 1
    assert "refuse: it must not be used" in out
    assert json.loads((solved / "hand_eye.json").read_text())["verdict"] == "refuse"
    (tmp_path / "cell.toml").write_text("[hand_eye]\nfile = 'used.json'\n")
    code, _, err = calibrate(capsys, "activate", solved, "--config", tmp_path / "cell.toml")
    assert code == 1
    assert "was refused when it was solved" in err
    assert not (tmp_path / "used.json").exists()


def test_a_failed_verification_refuses_the_result(capsys: pytest.CaptureFixture[str], solved: Path) -> None:
    path = solved / "observations.json"
    document = json.loads(path.read_text())
    held_out = [view for view in document["views"] if view["held_out"]]
    held_out[0]["T_base_flange"][0][3] += 0.01
    path.write_text(json.dumps(document))
    code, out, _ = calibrate(capsys, "solve", solved, "--again", "--json")
    assert code == 1
    assert [finding["code"] for finding in json.loads(out)["findings"]] == ["verification-failed"]


def test_activate_makes_a_result_the_active_calibration(
    capsys: pytest.CaptureFixture[str], solved: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "cell.toml").write_text(f"{REAL_CELL}[hand_eye]\nfile = 'cell/used.json'\n")
    code, _, err = calibrate(capsys, "activate", solved, "--config", tmp_path / "cell.toml")
    assert code == 0, err
    assert f"active calibration: {tmp_path / 'cell' / 'used.json'}" in err
    assert (tmp_path / "cell" / "used.json").read_bytes() == (solved / "hand_eye.json").read_bytes()
    monkeypatch.setenv("POINTCHAIN_DATA_DIR", str(tmp_path / "data"))
    (tmp_path / "other.toml").write_text(REAL_CELL)
    code, _, err = calibrate(capsys, "activate", solved / "hand_eye.json", "--config", tmp_path / "other.toml")
    assert code == 0, err
    assert (tmp_path / "data" / "calibration" / "hand_eye.json").is_file()
    code, _, err = calibrate(capsys, "activate", tmp_path / "none.json")
    assert code == 1
    assert f"there is no hand-eye calibration {tmp_path / 'none.json'}: give the file of a solved calibration" in err
    assert "hand_eye.file" not in err


@pytest.mark.parametrize(
    ("cell", "expected"),
    [
        (
            "[arm]\nkind = 'ur'\nhost = '10.0.0.1'\n[camera]\nkind = 'oak'\ndevice = '184430'\n",
            "with camera 19443010, this is camera 184430",
        ),
        ("[camera]\nkind = 'oak'\n", "with robot 20225500123, this is robot 2025050001"),
        ("", "with camera 19443010, this is camera simulated-oak-d-pro-3"),
    ],
    ids=["another camera", "a simulated arm", "the default cell"],
)
def test_a_result_of_another_camera_or_robot_is_not_activated(
    capsys: pytest.CaptureFixture[str], solved: Path, tmp_path: Path, cell: str, expected: str
) -> None:
    (tmp_path / "cell.toml").write_text(f"{cell}[hand_eye]\nfile = 'used.json'\n")
    code, out, err = calibrate(capsys, "activate", solved, "--config", tmp_path / "cell.toml")
    assert (code, out) == (1, "")
    assert expected in err
    assert "give the configuration of its own cell by --config" in err
    assert not (tmp_path / "used.json").exists()


@pytest.mark.parametrize("device", ["19443010", "192.168.1.20", "1.2.3"], ids=["same", "address", "port"])
def test_a_result_is_activated_if_the_camera_is_the_same_or_unknown(
    capsys: pytest.CaptureFixture[str], solved: Path, tmp_path: Path, device: str
) -> None:
    (tmp_path / "cell.toml").write_text(f"{REAL_CELL}device = '{device}'\n[hand_eye]\nfile = 'used.json'\n")
    code, _, err = calibrate(capsys, "activate", solved, "--config", tmp_path / "cell.toml")
    assert code == 0, err
    assert (tmp_path / "used.json").exists()


def test_the_activation_command_has_the_configuration() -> None:
    assert activation_command(Path("run"), None) == "pointchain calibrate activate run"
    command = activation_command(Path("my run"), Path("cell.toml"))
    assert command == "pointchain calibrate activate 'my run' --config cell.toml"


def test_an_eye_to_hand_result_is_solved_and_not_activated(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    recorded = record(1, 15, mounting="eye-to-hand")
    write_observations(tmp_path / "observations.json", recorded.observations)
    code, out, err = calibrate(capsys, "solve", tmp_path, "--again")
    assert code == 0, out + err
    assert "T_base_camera: " in out
    assert "so the calibration is not verified" in " ".join(out.split())
    document = json.loads((tmp_path / "hand_eye.json").read_text())
    # about three standard deviations for fifteen views by a robot with errors of 0.1 mm and 0.02 degrees per axis
    assert document["T_base_camera"]["xyz_m"] == pytest.approx(recorded.X[:3, 3], abs=1e-3)
    code, _, err = calibrate(capsys, "activate", tmp_path)
    assert code == 1
    assert "a camera that stands in the cell" in err


@pytest.mark.parametrize(
    ("spoil", "slug"),
    [
        (lambda folder: (folder / "setup.json").unlink(), "calibration-folder"),
        (lambda folder: [path.unlink() for path in folder.glob("0[1-7].png")], "too-few-views"),
        (
            lambda folder: change_poses(
                folder, lambda pose: pose | {"xyz_m": [1000 * value for value in pose["xyz_m"]]}
            ),
            "millimetres",
        ),
        (
            lambda folder: change_poses(
                folder, lambda pose: {"xyz_m": pose["xyz_m"], "rotvec_rad": [170.0, 20.0 + 30 * pose["xyz_m"][0], 5.0]}
            ),
            "degrees",
        ),
        (lambda folder: change_poses(folder, lambda pose: pose | {"quat_xyzw": [1, 0, 0, 0]}), "pure-translation"),
        (lambda folder: change_poses(folder, lambda pose: None), "calibration-folder"),
    ],
    ids=["no setup", "too few", "millimetres", "degrees", "no rotation", "no poses"],
)
def test_a_folder_that_cannot_be_solved_gives_its_problem_type(
    capsys: pytest.CaptureFixture[str], folder: Path, spoil: Any, slug: str
) -> None:
    spoil(folder)
    code, out, err = calibrate(capsys, "solve", folder, "--json")
    assert code == 1
    error = json.loads(out)["error"]
    assert error["type"] == f"urn:pointchain:{slug}", error
    assert error["detail"] in err
    assert not (folder / "hand_eye.json").exists()


def test_mirrored_images_are_reported(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    code, out, _ = calibrate(capsys, "solve", rendered_folder(tmp_path, views=2, held_out=0, mirrored=True), "--json")
    assert code == 1
    assert json.loads(out)["error"]["type"] == "urn:pointchain:board-mirrored"


def test_solve_again_needs_observations(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    code, out, err = calibrate(capsys, "solve", tmp_path, "--again")
    assert (code, out) == (1, "")
    assert "observations.json: solve from the images first" in err


def test_a_result_that_cannot_be_written_is_printed(
    capsys: pytest.CaptureFixture[str], solved: Path, tmp_path: Path
) -> None:
    out_file = tmp_path / "none" / "hand_eye.json"
    code, out, err = calibrate(capsys, "solve", solved, "--again", "--out", out_file)
    assert code == 1
    assert "Verdict         accept" in out
    assert "Verified        the board appears where it lay" in out
    assert f"{tmp_path / 'none' / 'observations.json'} cannot be written: No such file or directory" in err
    assert "wrote" not in err
    code, out, err = calibrate(capsys, "solve", solved, "--again", "--json", "--out", out_file)
    assert code == 1
    document = json.loads(out)
    assert document["error"]["type"] == "urn:pointchain:file"
    assert "status" not in document["error"], "a command line has no HTTP status"
    assert (document["verdict"], document["verification"]["passed"]) == ("accept", True)
