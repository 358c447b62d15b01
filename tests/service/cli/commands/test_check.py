"""`pointchain check` and `pointchain viewpoints`: text for people and JSON for programs."""

import json
import os
from datetime import UTC, datetime
from pathlib import Path
from types import SimpleNamespace

import pytest

from calibration.geometry.transforms import from_rotation_vector
from calibration.storage.hand_eye_file import write_hand_eye
from cell.self_test.check_result import CheckResult, Outcome
from service.cli.commands import check
from service.cli.main import main
from service.config.loader import ServiceConfig
from service.config.sections import LimitsConfig
from service.errors import ServiceError
from service.storage.disk_space import require_space
from tests.cell.loopback import free_host


@pytest.fixture(autouse=True)
def clear_variables(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in [name for name in os.environ if name.upper().startswith("POINTCHAIN_")]:
        monkeypatch.delenv(name)


@pytest.fixture
def unreachable_cell(tmp_path: Path) -> Path:
    """Return the configuration of a cell whose robot does not answer and whose camera is not connected."""
    write_hand_eye(
        tmp_path / "hand_eye.json",
        from_rotation_vector((0.03, -0.06, 0.05), (0.1, 0.05, 0.4)),
        created=datetime.now(UTC),
        camera_id="1944",
        robot_serial="2022",
    )
    path = tmp_path / "cell.toml"
    path.write_text(
        f'data_dir = "{tmp_path / "data"}"\n[arm]\nkind = "ur"\nhost = "{free_host()}"\n[camera]\nkind = "oak"\n'
        '[hand_eye]\nfile = "hand_eye.json"\n'
    )
    return path


def test_check_prints_what_is_wrong_and_what_to_do(unreachable_cell: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", "--config", str(unreachable_cell)]) == 1
    out, err = capsys.readouterr()
    assert err == ""
    lines = out.splitlines()
    starts = [line.split()[:2] for line in lines if not line.startswith(" ")]
    assert starts[:3] == [["ok", "configuration"], ["failed", "controller"], ["skipped", "robot"]]
    assert ["failed", "camera"] in starts
    assert ["ok", "data"] in starts
    assert "-> check arm.host" in out
    assert max(map(len, lines)) <= 120, "wrapped to the terminal"
    assert lines[-1] == "The cell cannot scan: 5 ok, 2 failed, 7 skipped."


def test_check_prints_the_same_as_json(unreachable_cell: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", "--config", str(unreachable_cell), "--json"]) == 1
    document = json.loads(capsys.readouterr().out)
    assert document["passed"] is False
    outcomes = {step["name"]: step["outcome"] for step in document["steps"]}
    assert (outcomes["controller"], outcomes["camera"], outcomes["data folder"]) == ("failed", "failed", "ok")
    assert all(set(step) == {"name", "outcome", "message", "what_to_do", "figures"} for step in document["steps"])


def test_a_wrong_configuration_is_the_only_step(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "cell.toml"
    path.write_text("[arm]\nspeed_rad_s = 0\n[camera]\nfps = 100\n")
    assert main(["check", "--config", str(path)]) == 1
    out = capsys.readouterr().out
    assert "arm.speed_rad_s is 0" in out
    assert "camera.fps is 100" in out
    assert out.splitlines()[-1] == "The cell cannot scan: 1 failed."


def test_the_data_folder_is_checked_and_not_created(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "not" / "yet"
    step = check.check_data_folder(ServiceConfig(data_dir=folder))
    assert step.outcome == "ok"
    assert str(folder) in step.message
    assert not folder.exists()
    (tmp_path / "file").write_text("")
    assert check.check_data_folder(ServiceConfig(data_dir=tmp_path / "file")).outcome == "failed"
    monkeypatch.setattr(check, "LOW_FREE_BYTES", 1 << 80)
    assert check.check_data_folder(ServiceConfig(data_dir=folder)).outcome == "warning"


def test_the_data_folder_needs_the_space_that_the_service_needs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = ServiceConfig(data_dir=tmp_path, limits=LimitsConfig(min_free_bytes=300 << 20))
    usage = SimpleNamespace(free=config.limits.min_free_bytes)
    monkeypatch.setattr("shutil.disk_usage", lambda _: usage)
    require_space(tmp_path, config.limits.min_free_bytes)
    assert check.check_data_folder(config).outcome == "warning"
    usage.free -= 1 << 20
    with pytest.raises(ServiceError):
        require_space(tmp_path, config.limits.min_free_bytes)
    step = check.check_data_folder(config)
    assert step.outcome == "failed"
    assert step.message == f"{tmp_path}, 299 MiB free; starting a scan needs 300 MiB"
    assert step.what_to_do is not None
    assert "limits.min_free_bytes" in step.what_to_do


@pytest.mark.parametrize(
    ("outcomes", "expected"),
    [
        (("ok", "ok"), "The cell is ready to scan: 2 ok."),
        (("ok", "warning"), "The cell is ready to scan: 1 ok, 1 warning."),
        (("ok", "skipped"), "No step failed, but some were skipped: 1 ok, 1 skipped."),
        (("failed", "skipped"), "The cell cannot scan: 1 failed, 1 skipped."),
    ],
)
def test_the_summary_follows_from_the_steps(outcomes: tuple[Outcome, Outcome], expected: str) -> None:
    assert check.summarise([CheckResult("one", outcome, "message") for outcome in outcomes]) == expected


def test_viewpoints_are_listed_and_drawn_without_a_device(
    unreachable_cell: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    picture = tmp_path / "plan.png"
    assert main(["viewpoints", "--config", str(unreachable_cell), "--picture", str(picture)]) == 0
    out, err = capsys.readouterr()
    head, *rows, summary = out.splitlines()
    assert head.split() == ["view", "order", "azimuth", "elevation", "distance", "roll", "reached"]
    assert [row.split()[0] for row in rows] == [str(index) for index in range(8)]
    turns = sorted(int(row.split()[1]) for row in rows if row.split()[1] != "-")
    assert turns == list(range(1, len(turns) + 1))
    assert summary.startswith(f"{len(turns)} of 8 reached, from home (")
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert str(picture) in err


def test_viewpoints_warn_about_calibration_and_coverage(
    unreachable_cell: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (unreachable_cell.parent / "hand_eye.json").write_text(
        '{"T_flange_camera": {"xyz_m": [0, 0, 0.05], "quat_xyzw": [1, 0, 0, 0]}}'
    )
    unreachable_cell.write_text(
        unreachable_cell.read_text() + "[workspace]\nx_m = [0.2, 1.0]\ny_m = [-0.7, 0.7]\n[scan]\nmin_views = 2\n"
    )
    main(["viewpoints", "--config", str(unreachable_cell)])
    out, err = capsys.readouterr()
    assert "the camera looks back at the arm" in err
    assert "does not say when it was made" in err
    assert out.splitlines()[-1].startswith("Warning: ")
    assert "% of the table in the workspace" in out.splitlines()[-1]


def test_viewpoints_prints_json(unreachable_cell: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["viewpoints", "--config", str(unreachable_cell), "--views", "5", "--json"]) == 0
    plan = json.loads(capsys.readouterr().out)
    assert [viewpoint["index"] for viewpoint in plan["viewpoints"]] == [0, 1, 2, 3, 4]
    assert plan["legs"][-1]["view"] is None, "the last move goes home"


def test_too_few_viewpoints_fail_with_reasons(unreachable_cell: Path, capsys: pytest.CaptureFixture[str]) -> None:
    unreachable_cell.write_text(unreachable_cell.read_text() + "[workspace]\nx_m = [0.7, 1.2]\n[scan]\nmin_views = 8\n")
    assert main(["viewpoints", "--config", str(unreachable_cell)]) == 1
    out, err = capsys.readouterr()
    assert "  no: " in out
    assert "viewpoints can be reached, 8 are needed" in err


@pytest.mark.parametrize("views", ["0", "33", "-4", "eight", "²"])
def test_an_impossible_number_of_views_is_rejected(views: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as raised:
        main(["viewpoints", f"--views={views}"])
    assert raised.value.code == 2
    assert 'a whole number from 1 to 32 or "auto" is needed' in capsys.readouterr().err


def test_viewpoints_need_a_calibration(unreachable_cell: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (unreachable_cell.parent / "hand_eye.json").unlink()
    assert main(["viewpoints", "--config", str(unreachable_cell)]) == 1
    assert "there is no hand-eye calibration" in capsys.readouterr().err


def test_a_picture_that_cannot_be_written_is_reported(
    unreachable_cell: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["viewpoints", "--config", str(unreachable_cell), "--picture", str(unreachable_cell / "x.png")]) == 1
    assert "x.png cannot be written" in capsys.readouterr().err
