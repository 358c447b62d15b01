"""`pointchain calibrate run` and `verify`: the real ur_rtde and depthai, a virtual controller, a rendered board.

The true pose of the camera on the flange is known.
"""

import io
import json
import re
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from calibration.geometry.transforms import inverse, rotation_angle
from calibration.storage.hand_eye_file import load_hand_eye
from cell.simulation.pose_errors import T_FLANGE_CAMERA
from service.cli.main import main
from tests.cell.loopback import free_host
from tests.docs.outputs import WORDS, differences, shown_after
from tests.service.signalled import assert_stopped, interrupt

pytestmark = pytest.mark.xdist_group("service")  # one at a time, because each test runs several busy processes

TIMEOUT_S = 120
"""Timeout, seconds. A busy machine needs time to load the libraries."""


def fast_cell(folder: Path, host: str, time_factor: float = 20.0) -> Path:
    """Write the configuration of a fast simulated cell that keeps its data in `folder`."""
    path = folder / "cell.toml"
    path.write_text(
        f"data_dir = '{folder / 'data'}'\n[arm]\nhost = '{host}'\ntime_factor = {time_factor}\nwatchdog_hz = 1.0\n"
        "[camera]\nmodel = 'exact'\nfps = 30\nexposures = 1\nsettle_s = 0.0\n"
    )
    return path


class Terminal(io.StringIO):
    """Terminal with prepared input."""

    def isatty(self) -> bool:
        return True


def calibrate(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, str, str]:
    """Return the exit code, stdout and stderr."""
    code = main(["calibrate", *(str(argument) for argument in arguments)])
    out, err = capsys.readouterr()
    return code, out, err


def shift_by_mm(path: Path, millimetres: float) -> None:
    """Shift the camera along x in the hand-eye file."""
    document = json.loads(path.read_text())
    document["T_flange_camera"]["xyz_m"][0] += millimetres / 1000
    path.write_text(json.dumps(document))


def test_a_new_cell_is_calibrated_activated_and_verified(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config, run = fast_cell(tmp_path, free_host()), tmp_path / "run"
    active = tmp_path / "data" / "calibration" / "hand_eye.json"
    monkeypatch.setattr(sys, "stdin", Terminal("n\n"))
    code, out, err = calibrate(capsys, "run", "--config", config, "--folder", run, "--json")
    assert code == 0, err
    assert "the arm will move through 17 poses" in err
    assert "of the image covered so far" in err
    assert f"activate this calibration as {active}? [y/N]" in err
    assert f"to activate it: pointchain calibrate activate {run} --config {config}" in err
    document = json.loads(out)
    assert (document["activated"], document["folder"], document["unseen"]) == (False, str(run), [])
    assert document["verification"]["passed"] is True
    assert not active.exists()
    off = inverse(T_FLANGE_CAMERA) @ load_hand_eye(run / "hand_eye.json", 1.0).T_flange_camera
    # limits for a simulated cell whose robot has errors of 0.5 mm and 0.1 degrees (rms)
    assert np.linalg.norm(off[:3, 3]) < 4e-4
    assert np.degrees(rotation_angle(off)) < 0.08

    code, _, err = calibrate(capsys, "run", "--config", config, "--folder", run)
    assert code == 1
    assert "is not an empty folder" in err
    code, _, err = calibrate(capsys, "activate", run, "--config", config)
    assert code == 0, err
    code, out, err = calibrate(capsys, "verify", "--config", config)
    assert code == 0, out + err
    assert out.startswith("Verified        the board appears where it lay")
    shown = shown_after("docs/integrator/calibration.md", "pointchain calibrate verify --config cell.toml")
    pose = re.compile(r"\d+_pose\d+")  # the order of the poses depends on the camera
    assert differences(pose.sub("pose", shown), pose.sub("pose", out), WORDS) == []
    shift_by_mm(active, 8.0)
    code, out, err = calibrate(capsys, "verify", "--config", config, "--json", "--folder", tmp_path / "drifted")
    assert code == 1, err
    assert json.loads(out)["passed"] is False
    assert len(list((tmp_path / "drifted").glob("*.png"))) == 2


def test_yes_does_not_activate_an_unverified_result(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config, run = fast_cell(tmp_path, free_host()), tmp_path / "run"
    config.write_text(config.read_text() + "working_m = [0.55, 1.0]\n")  # so that most poses have the same distance
    monkeypatch.setattr("service.cli.calibrate.run.HELD_OUT", 0)
    code, out, err = calibrate(capsys, "run", "--config", config, "--folder", run, "--yes", "--json")
    assert code == 0, err
    assert json.loads(out)["activated"] is False
    assert "the result is not verified, so --yes does not activate it" in err
    assert f"to activate it: pointchain calibrate activate {run} --config {config}" in err
    assert not (tmp_path / "data" / "calibration" / "hand_eye.json").exists()
    assert "an error of the board's size or of the focal length goes unnoticed" in err[: err.index("moving to pose")]


@pytest.mark.parametrize("command", ["run", "verify"])
def test_a_folder_that_cannot_be_created_or_read_is_reported(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, command: str
) -> None:
    config = fast_cell(tmp_path, free_host())
    for folder, why in (
        (config / "run", "Not a directory"),
        (tmp_path / ("x" * 300), "File name too long"),
        (config, "is not an empty folder"),
        (tmp_path, "is not an empty folder"),
    ):
        code, out, err = calibrate(capsys, command, "--config", config, "--folder", folder, "--json")
        assert code == 1
        problem = json.loads(out)["error"]
        assert "status" not in problem, "a command line has no HTTP status"
        assert why in problem["detail"]
        assert "by --folder" in problem["detail"]
        assert "connecting" not in err


def test_a_signal_stops_the_arm_and_the_images_are_kept(tmp_path: Path) -> None:
    host, run = free_host(), tmp_path / "run"
    command = [sys.executable, "-c", "import sys; from service.cli.main import main; sys.exit(main(sys.argv[1:]))"]
    command += ["calibrate", "run", "--json", "--folder", str(run), "--config", str(fast_cell(tmp_path, host, 2.0))]
    with subprocess.Popen(
        command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as running:
        try:
            assert running.stderr is not None
            while "recorded, 1 of" not in (line := running.stderr.readline()):
                assert line, "the command ended"
            out, err, events = interrupt(running, host, signal.SIGTERM, TIMEOUT_S)
        finally:
            running.kill()
    assert running.returncode == 130, err
    error = json.loads(out)["error"]
    assert error["type"] == "urn:pointchain:stopped"
    assert f"the images taken until then are in {run}" in error["detail"]
    assert 1 <= len(list(run.glob("*.png"))) < 17
    assert not (run / "hand_eye.json").exists()
    assert_stopped(events)


def test_calibrate_reports_why_it_cannot_start(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    config = fast_cell(tmp_path, free_host())
    code, _, err = calibrate(capsys, "run", "--config", config, "--rows", "6")
    assert code == 1
    assert "an odd number is needed" in err
    code, _, err = calibrate(capsys, "run", "--config", tmp_path / "none.toml")
    assert code == 1
    assert "no such configuration file" in err
    code, out, err = calibrate(capsys, "verify", "--config", config, "--json")
    assert code == 1, "there is no calibration to verify yet"
    assert json.loads(out)["error"]["type"] == "urn:pointchain:calibration"
    with pytest.raises(SystemExit):
        calibrate(capsys, "run", "--poses", "3")
    assert "from 10 to 40 poses are possible" in capsys.readouterr().err
