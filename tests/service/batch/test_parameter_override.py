"""`pointchain recognise --set` replaces parameters that follow from the radius."""

import json
from pathlib import Path
from typing import Any

import pytest

from cell.simulation.offline_scan import simulate, write_simulation
from cell.simulation.rendering.depth_camera import camera_model
from cell.simulation.scenes.scenes import make_scene
from service.cli.main import main


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("set") / "paper.mcap"
    write_simulation(simulate(make_scene("loop", 2), camera_model("exact", (320, 200)), 0, views=4), path)
    return path


def recognised(capsys: pytest.CaptureFixture[str], *arguments: object) -> dict[str, Any]:
    assert main(["recognise", *map(str, arguments)]) == 0
    document = json.loads(capsys.readouterr().out)
    document.pop("timing_s")
    return document


def test_the_model_and_its_line_hold_the_settings(recording: Path, capsys: pytest.CaptureFixture[str]) -> None:
    plain = recognised(capsys, recording)
    changed = recognised(capsys, recording, "--set", "z_t=0.004", "--set", "r_cn=0.013")
    assert changed["parameters"] == plain["parameters"] | {"z_t_m": 0.004, "r_cn_m": 0.013}
    assert changed["request"] == plain["request"] | {"settings": {"r_cn": 0.013, "z_t": 0.004}}
    assert changed["chains"] != plain["chains"]
    # the order on the command line does not matter
    assert recognised(capsys, recording, "--set", "r_cn=0.013", "--set", "z_t=0.004") == changed


def test_setting_the_default_values_gives_the_same_model(recording: Path, capsys: pytest.CaptureFixture[str]) -> None:
    plain = recognised(capsys, recording)
    same = recognised(capsys, recording, "--set", f"r_cn={plain['parameters']['r_cn_m']!r}")
    assert same["chains"] == plain["chains"]
    assert same["quality"] == plain["quality"]


def test_worker_processes_use_the_settings(recording: Path, capsys: pytest.CaptureFixture[str]) -> None:
    alone = recognised(capsys, recording, "--method", "enhanced", "--set", "rho_t=0.8")
    assert alone["parameters"]["rho_t"] == 0.8
    assert recognised(capsys, recording, "--method", "enhanced", "--set", "rho_t=0.8", "--jobs", 1) == alone


def test_an_output_file_with_other_settings_is_unchanged(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out.jsonl"
    command = ["recognise", str(recording), "--out", str(out)]
    assert main([*command, "--set", "z_t=0.004"]) == 0
    before = out.read_bytes()
    for others in ([], ["--set", "z_t=0.0045"], ["--set", "r_cn=0.013"]):
        capsys.readouterr()
        assert main([*command, *others]) == 1
        assert "settings {'z_t': 0.004}, now" in capsys.readouterr().err
        assert out.read_bytes() == before
    assert main([*command, "--set", "z_t=0.004"]) == 0
    assert "1 were done before" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--set", "r_c=0.004"], "the method 'graph' does not use r_c"),
        (["--set", "r=0.004"], "use --radius"),
        (["--set", "width=1"], "no parameter 'width'; the parameters are z_t,"),
        (["--set", "z_t=0.004", "--set", "z_t=0.005"], "--set gives z_t more than once"),
        (["--set", "z_t=0.01", "--radius", "0.0042"], "the parameters break 0 < z_t < 2 r (Table I)"),
    ],
)
def test_invalid_settings_are_rejected_before_any_work(
    recording: Path, arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["recognise", str(recording), *arguments]) == 1
    captured = capsys.readouterr()
    assert message in captured.err
    assert captured.out == ""


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ("z_t", "'z_t' is not NAME=VALUE"),
        ("=1", "is not NAME=VALUE"),
        ("z_t=thick", "z_t is 'thick'; a finite number is needed"),
        ("z_t=nan", "z_t is 'nan'; a finite number is needed"),
        ("z_t=", "z_t is ''; a finite number is needed"),
    ],
)
def test_a_setting_needs_a_finite_number(
    recording: Path, setting: str, message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        main(["recognise", str(recording), "--set", setting])
    assert message in capsys.readouterr().err


def test_a_setting_that_breaks_the_constraints_of_one_recording_is_an_error_on_its_line(
    recording: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["recognise", str(recording), "--set", "z_t=0.01"]) == 1
    error = json.loads(capsys.readouterr().out)["error"]
    assert error["type"] == "urn:pointchain:invalid-parameters"
    assert "0 < z_t < 2 r" in error["detail"]
