"""Configuration: what wins, and what is refused by which name."""

from pathlib import Path

import pytest

from recognition.gripper import Gripper
from service.config import ConfigError, load_config


@pytest.fixture(autouse=True)
def no_variables(monkeypatch: pytest.MonkeyPatch) -> None:
    import os

    for name in [name for name in os.environ if name.upper().startswith("POINTCHAIN_")]:
        monkeypatch.delenv(name)


def write(folder: Path, text: str) -> Path:
    path = folder / "cell.toml"
    path.write_text(text)
    return path


def test_without_anything_it_listens_on_loopback_only() -> None:
    config = load_config()
    assert config.host == "127.0.0.1"
    assert config.data_dir.is_absolute()


def test_later_sources_win(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write(tmp_path, 'host = "a"\nport = 1\n[limits]\nupload_bytes = 11\nrequest_bytes = 12\n')
    monkeypatch.setenv("POINTCHAIN_PORT", "2")
    monkeypatch.setenv("POINTCHAIN_LIMITS__UPLOAD_BYTES", "22")
    assert load_config(path).port == 2
    config = load_config(path, port=3, host=None)
    assert (config.host, config.port) == ("a", 3)
    assert (config.limits.upload_bytes, config.limits.request_bytes) == (22, 12)


def test_the_gripper_is_described_in_metres(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert load_config().gripper.value == Gripper()
    path = write(tmp_path, "[gripper]\nstroke_m = 0.05\nfinger_width_m = 0.02\n")
    monkeypatch.setenv("POINTCHAIN_GRIPPER__STROKE_M", "0.04")
    assert load_config(path).gripper.value == Gripper(stroke_m=0.04, finger_width_m=0.02)


def test_a_variable_names_the_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("POINTCHAIN_CONFIG", str(write(tmp_path, "port = 7")))
    assert load_config().port == 7


def test_a_relative_data_folder_is_of_the_working_directory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert load_config(data_dir="here").data_dir == tmp_path / "here"


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("prot = 1", "prot"),
        ("[limits]\nuplod_bytes = 1", "limits.uplod_bytes"),
        ("port = 70000", "port"),
        ('port = "many"', "port"),
        ("[limits]\nupload_bytes = 0", "limits.upload_bytes"),
        ("[limits]\nrecognition_s = nan", "limits.recognition_s"),
        ('host = ""', "host"),
        ("[gripper]\nstroke_m = 85", "metres, not mm"),
        ("[gripper]\nfinger_width_m = 0.0", "finger_width_m is 0 m"),
        ("[gripper]\nclearance_m = nan", "clearance_m is nan"),
        ("[gripper]\nfinger_m = 0.01", "gripper.finger_m"),
        ('[gripper]\nstroke_m = "wide"', "gripper.stroke_m"),
        ("port = ", "not TOML"),
    ],
)
def test_a_wrong_file_is_refused_by_name(tmp_path: Path, text: str, named: str) -> None:
    path = write(tmp_path, text)
    with pytest.raises(ConfigError) as refused:
        load_config(path)
    assert named in str(refused.value)
    assert str(path) in str(refused.value)


@pytest.mark.parametrize(
    "variable",
    ["POINTCHAIN_PROT", "POINTCHAIN_LIMITS__UPLOD_BYTES", "POINTCHAIN_PORT", "POINTCHAIN_LIMIT__X"],
)
def test_a_wrong_variable_is_refused_by_name(variable: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(variable, "many")
    with pytest.raises(ConfigError, match=variable):
        load_config()


def test_a_missing_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="no such configuration file"):
        load_config(tmp_path / "none.toml")
