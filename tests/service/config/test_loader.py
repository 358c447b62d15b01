"""Configuration: the order of its sources, and messages that name what is wrong."""

from dataclasses import replace
from pathlib import Path

import pytest

from cell.config.arm_config import SimulatedArm, URArm
from cell.config.camera_config import OakCamera
from cell.config.cell_config import CellSettings, HandEyeSettings
from recognition.grasping.gripper import Gripper, GripperBox
from recognition.grasping.gripper_presets import PRESETS, with_adapter
from service.config.loader import ConfigError, load_config


@pytest.fixture(autouse=True)
def clear_variables(monkeypatch: pytest.MonkeyPatch) -> None:
    import os

    for name in [name for name in os.environ if name.upper().startswith("POINTCHAIN_")]:
        monkeypatch.delenv(name)


def write(folder: Path, text: str) -> Path:
    path = folder / "cell.toml"
    path.write_text(text)
    return path


def test_the_default_configuration_listens_on_loopback_only() -> None:
    config = load_config()
    assert config.host == "127.0.0.1"
    assert config.data_dir.is_absolute()


def test_later_sources_override_earlier_ones(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write(tmp_path, 'host = "a"\nport = 1\n[limits]\nupload_bytes = 11\nrequest_bytes = 12\n')
    monkeypatch.setenv("POINTCHAIN_PORT", "2")
    monkeypatch.setenv("POINTCHAIN_LIMITS__UPLOAD_BYTES", "22")
    assert load_config(path).port == 2
    config = load_config(path, port=3, host=None)
    assert (config.host, config.port) == ("a", 3)
    assert (config.limits.upload_bytes, config.limits.request_bytes) == (22, 12)


def test_the_gripper_is_configured_in_metres(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert load_config().gripper.to_gripper() == Gripper()
    path = write(tmp_path, "[gripper]\nstroke_m = 0.05\nfinger_width_m = 0.02\n")
    monkeypatch.setenv("POINTCHAIN_GRIPPER__STROKE_M", "0.04")
    assert load_config(path).gripper.to_gripper() == Gripper(stroke_m=0.04, finger_width_m=0.02)


def test_single_dimensions_override_those_of_a_preset(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write(tmp_path, '[gripper]\npreset = "robotiq-hand-e"\nfinger_width_m = 0.008\n')
    hand_e = PRESETS["robotiq-hand-e"]
    assert load_config(path).gripper.to_gripper() == replace(hand_e, finger_width_m=0.008)
    monkeypatch.setenv("POINTCHAIN_GRIPPER__LENGTH_M", "0.2")
    assert load_config(path).gripper.to_gripper() == replace(with_adapter(hand_e, 0.2), finger_width_m=0.008)
    monkeypatch.setenv("POINTCHAIN_GRIPPER__BODY_M", "[[[0.1, 0.04, 0.1], [-0.1, -0.04, 0]]]")
    assert load_config(path).gripper.to_gripper().body == (GripperBox((-0.1, -0.04, 0.0), (0.1, 0.04, 0.1)),)


@pytest.mark.parametrize(
    ("text", "described"),
    [
        ("", False),
        ("[gripper]\nstroke_m = 0.05", False),
        ("[gripper]\nlength_m = 0.174", True),
        ('[gripper]\npreset = "onrobot-rg2"', True),
        ("[gripper]\nbody_m = [[[-0.1, -0.1, 0], [0.1, 0.1, 0.1]]]", True),
    ],
)
def test_a_gripper_is_a_body_of_the_cell_only_if_it_is_described(tmp_path: Path, text: str, described: bool) -> None:
    assert load_config(write(tmp_path, text)).cell.gripper.is_described == described


def test_a_variable_names_the_configuration_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("POINTCHAIN_CONFIG", str(write(tmp_path, "port = 7")))
    assert load_config().port == 7


def test_a_relative_data_folder_counts_from_the_working_directory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert load_config(data_dir="here").data_dir == tmp_path / "here"


@pytest.mark.parametrize(
    ("text", "expected"),
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
        ('[gripper]\npreset = "robotiq-2f85"', 'did you mean "robotiq-2f-85"?'),
        ('[gripper]\npreset = "schunk-egp-50"\nlength_m = 185', "metres, not mm"),
        ("[gripper]\nbody_m = [[[0, 0, 0], [0.1, 0.1, 0]]]", "box 1 reaches from z = 0 to 0 m"),
        ('[gripper]\nstroke_m = "wide"', "gripper.stroke_m"),
        ("port = ", "not TOML"),
    ],
)
def test_an_error_names_the_key_and_the_file(tmp_path: Path, text: str, expected: str) -> None:
    path = write(tmp_path, text)
    with pytest.raises(ConfigError) as raised:
        load_config(path)
    assert expected in str(raised.value)
    assert str(path) in str(raised.value)


@pytest.mark.parametrize(
    "variable",
    ["POINTCHAIN_PROT", "POINTCHAIN_LIMITS__UPLOD_BYTES", "POINTCHAIN_PORT", "POINTCHAIN_LIMIT__X"],
)
def test_an_error_names_the_variable(variable: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(variable, "many")
    with pytest.raises(ConfigError, match=variable):
        load_config()


def test_a_missing_file_is_rejected(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="no such configuration file"):
        load_config(tmp_path / "none.toml")


REAL = """
[arm]
kind = "ur"
model = "ur10e"
host = "192.168.1.10"
home_q_rad = [0.0, -1.6, 1.6, -1.6, -1.6, 0.0]
[camera]
kind = "oak"
device = "19443010C1E4481200"
[hand_eye]
file = "hand_eye.json"
[workspace]
x_m = [0.3, 0.8]
y_m = [-0.26, 0.26]
[mounting]
table_z_m = -0.4
obstacles_m = [[[0.5, 0.5, 0.0], [0.9, 0.9, 0.3]]]
[scan]
views = 12
"""


def error_message(path: Path | None = None) -> str:
    """Return the error message of the configuration, without the name of the file."""
    with pytest.raises(ConfigError) as raised:
        load_config(path)
    return str(raised.value).replace(f" (file {path})", "")


def test_the_default_cell_is_simulated() -> None:
    config = load_config()
    folder = HandEyeSettings(folder=config.data_dir / "calibration")
    assert config.cell == CellSettings(hand_eye=folder)
    assert isinstance(config.cell.arm, SimulatedArm)


def test_a_real_cell_is_configured_in_sections(tmp_path: Path) -> None:
    cell = load_config(write(tmp_path, REAL)).cell
    assert cell.arm == URArm(kind="ur", model="ur10e", host="192.168.1.10", home_q_rad=(0, -1.6, 1.6, -1.6, -1.6, 0))
    assert isinstance(cell.camera, OakCamera)
    assert cell.workspace_m == ((0.3, 0.8), (-0.26, 0.26), (-0.4, -0.4 + 0.12))
    assert cell.mounting.obstacles_m == (((0.5, 0.5, 0.0), (0.9, 0.9, 0.3)),)
    assert (cell.scan.views, cell.scan.min_views) == (12, 4)


def test_a_relative_hand_eye_file_counts_from_the_configuration_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "etc"
    folder.mkdir()
    path = write(folder, REAL)
    monkeypatch.chdir(tmp_path)
    assert load_config(path).cell.hand_eye.file == folder / "hand_eye.json"
    assert load_config(Path("etc/cell.toml")).cell.hand_eye.file == folder / "hand_eye.json"
    path = write(folder, REAL.replace("hand_eye.json", "~/x.json"))
    assert load_config(path).cell.hand_eye.file == Path.home() / "x.json"
    monkeypatch.setenv("POINTCHAIN_HAND_EYE__FILE", "here.json")
    assert load_config(path).cell.hand_eye.file == tmp_path / "here.json"


def test_calibrations_are_kept_in_the_data_folder_by_default(tmp_path: Path) -> None:
    kept = load_config(write(tmp_path, "[camera]\nkind = 'oak'"), data_dir=tmp_path / "data").cell.hand_eye
    assert kept.folder == tmp_path / "data" / "calibration"
    assert kept.active_file == tmp_path / "data" / "calibration" / "hand_eye.json"
    elsewhere = load_config(write(tmp_path, "[hand_eye]\nfolder = 'kept'")).cell.hand_eye
    assert elsewhere.active_file == tmp_path / "kept" / "hand_eye.json"
    named = load_config(write(tmp_path, REAL), data_dir=tmp_path / "data").cell.hand_eye
    assert named.active_file == tmp_path / "hand_eye.json"


def test_variables_set_keys_of_every_section(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("POINTCHAIN_ARM__HOST", "10.0.0.7")
    monkeypatch.setenv("POINTCHAIN_CAMERA__IR_DOTS", "0.4")
    monkeypatch.setenv("POINTCHAIN_WORKSPACE__Y_M", "[-0.1, 0.1]")
    cell = load_config(write(tmp_path, REAL)).cell
    assert isinstance(cell.arm, URArm)
    assert (cell.arm.host, cell.arm.model) == ("10.0.0.7", "ur10e")
    assert isinstance(cell.camera, OakCamera)
    assert (cell.camera.ir_dots, cell.camera.device) == (0.4, "19443010C1E4481200")
    assert cell.workspace.y_m == (-0.1, 0.1)


def test_variables_alone_configure_a_real_cell(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    variables = {"ARM__KIND": "ur", "ARM__HOST": "ur5e.lan", "CAMERA": '{"kind": "oak"}', "HAND_EYE__FILE": "/x.json"}
    for name, value in variables.items():
        monkeypatch.setenv(f"POINTCHAIN_{name}", value)
    cell = load_config().cell
    assert cell.arm == URArm(kind="ur", host="ur5e.lan")
    assert cell.camera == OakCamera(kind="oak")


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("[arm]\nspeed_rad_s = 0", "arm.speed_rad_s is 0; it must be a number greater than 0 and at most 3.14"),
        ("[arm]\nspeed_rad_s = nan", "arm.speed_rad_s is nan; it must be a number greater than 0 and at most 3.14"),
        ("[camera]\nfps = 'many'", "camera.fps is 'many'; it must be a number from 1 to 60"),
        ("[camera]\nexposures = 1.5", "camera.exposures is 1.5; it must be a whole number from 1 to 25"),
        ("[arm]\nmodel = 'UR5e'", 'arm.model is \'UR5e\'; it must be "ur3e", "ur5e" or "ur10e"; did you mean "ur5e"?'),
        ("[arm]\nkind = 'urx'", 'arm.kind is \'urx\'; it must be "simulated" or "ur"'),
        ("[camera]\nkind = 3", 'camera.kind is 3; it must be "simulated" or "oak"'),
        ("[arm]\nkind = 'ur'", 'arm.host is missing; kind = "ur" requires it'),
        ("arm = 'ur5e'", "arm is 'ur5e'; it is a section: write [arm] and its settings below it"),
        ("limits = 3", "limits is 3; it is a section: write [limits] and its settings below it"),
        ("[worskpace]\nx_m = [0, 1]", "worskpace: unknown section; did you mean workspace?"),
        ("[arm]\nspeed = 1", "arm.speed: unknown setting; did you mean speed_rad_s?"),
        ("[scan]\nx = 1", "scan.x: unknown setting; known names: views, min_views, string_radius_m"),
        ("speed_rad_s = 1", "speed_rad_s: unknown setting; move it to the section [arm]"),
        ("[arm]\nfps = 3", "arm.fps: unknown setting; move it to the section [camera]"),
        ("[limits]\nport = 3", "limits.port: unknown setting; move it above the first [section]"),
        ("[camera]\ndevice = 'x'", 'camera.device: unknown setting; only kind = "oak" has it'),
        ("[workspace]\nx_m = [0.3]", "workspace.x_m is [0.3]; it must be a list of 2 numbers"),
        ("[workspace]\nx_m = [0.3, 'far']", "workspace.x_m[1] is 'far'; it must be a number"),
        ("[workspace]\nx_m = [0.3, 0.2]", "workspace.x_m is [0.3, 0.2]; the first must be less than the second"),
        ("[workspace]\ny_m = [-300, 300]", "workspace.y_m is [-300, 300]; metres are needed"),
        ("[arm]\nhome_q_rad = [0, 0, 0]", "arm.home_q_rad is [0, 0, 0]; it must be a list of 6 numbers"),
        ("[arm]\nhome_q_rad = [0, -90, 90, 0, 0, 0]", "angles are radians, not degrees"),
        ("[arm]\nhost = '192.168.1.3'", 'a simulated arm listens on 127.0.0.2 or above; a real one needs kind = "ur"'),
        ("[arm]\nhost = '127.0.0.1'", "127.0.0.2 or above"),
        ("[arm]\nkind = 'ur'\nhost = 'http://10.0.0.1'", "the controller's IP address or name alone is needed"),
        (
            "[mounting]\nobstacles_m = [[[0, 0, 0], [1, 1]]]",
            "mounting.obstacles_m[0][1] is [1, 1]; it must be a list of 3 numbers",
        ),
        ("[mounting]\nobstacles_m = [[[0, 0, 0], [1, 1, 0]]]", "box 1 is flat"),
        ("[camera]\nworking_m = [0.6, 0.3]", "the nearest and the farthest distance are needed"),
        ("[camera]\nbody_m = [100, 40, 40]", "in metres, as [0.10, 0.04, 0.04]"),
        ("[camera]\nscene = 'figure8'", "camera.scene is 'figure8'; the scenes are straight,"),
        ("[camera]\nstring_radius_m = 4.2", "camera.string_radius_m is 4.2; it must be a number from 0.0005 to 0.02"),
        ("[scan]\nstring_radius_m = 4.2", "from 0.0005 to 0.02; metres are expected, and 4.2 looks like millimetres"),
        ("[mounting]\ntable_z_m = -40", "from -3 to 3; metres are expected, and -40 looks like millimetres"),
        (
            "[arm]\nspeed_rad_s = 30",
            "at most 3.14; radians per second are expected, and 30 looks like degrees per second",
        ),
        (
            "[arm]\nacceleration_rad_s2 = 80",
            "radians per second squared are expected, and 80 looks like degrees per second squared",
        ),
        ("[arm]\nflange_speed_m_s = 250", "metres per second are expected, and 250 looks like millimetres per second"),
        ("[camera]\nkind = 'oak'\nextended_disparity = 'maybe'", "is 'maybe'; it must be true or false"),
        ("[scan]\nviews = 3", "scan: min_views is 4, more than the 3 views"),
        ("[scan]\nviews = 'many'", "scan.views is 'many'; a whole number from 1 to 32 or \"auto\" is needed"),
        ("[arm]\nkind = 'ur'\nhost = '10.0.0.1'", "camera.kind is missing"),
        ("[hand_eye]\nrough_xyz_m = [30, -60, 50]", "no camera is more than 1 m from the flange that carries it"),
        ("[hand_eye]\nrough_rotation_rad = [0, 0, 90]", "an angle in radians, not degrees"),
    ],
    ids=lambda value: str(value)[:40].replace("\n", " "),
)
def test_an_error_of_the_cell_names_the_key_and_what_it_accepts(tmp_path: Path, text: str, expected: str) -> None:
    assert expected in error_message(write(tmp_path, text))


@pytest.mark.parametrize(
    "text",
    [
        "[mounting]\ntable_z_m = 3.5",  # near its limit
        "[scan]\nstring_radius_m = 0.03",
        "[scan]\nstring_radius_m = 4200",  # in micrometres
        "[arm]\nspeed_rad_s = -30",
        "[arm]\nspeed_rad_s = 'fast'",
        "[camera]\nfps = 900",
    ],
)
def test_no_unit_hint_is_given_for_an_ambiguous_value(tmp_path: Path, text: str) -> None:
    message = error_message(write(tmp_path, text))
    assert "it must be" in message
    assert "expected" not in message


def test_all_errors_are_reported_at_once(tmp_path: Path) -> None:
    text = "[arm]\nspeed_rad_s = 0\nmodel = 'kuka'\n[camera]\nexpoures = 2\n[limits]\nupload_bytes = -1\n"
    lines = error_message(write(tmp_path, text)).splitlines()
    assert [line.split()[0].rstrip(":") for line in lines[1:]] == [
        "limits.upload_bytes",
        "arm.model",
        "arm.speed_rad_s",
        "camera.expoures",
    ]


@pytest.mark.parametrize(
    ("name", "value", "expected"),
    [
        ("ARM__HOTS", "x", "arm.hots (set by POINTCHAIN_ARM__HOTS): unknown setting; did you mean host?"),
        ("ARM", "ur", "arm (set by POINTCHAIN_ARM) is 'ur'; it is a section"),
        ("SCAN__STRING_RADIUS_M", "4.2", "metres are expected, and 4.2 looks like millimetres"),
        ("ARM", '{"speed_rad_s": 0}', "arm.speed_rad_s (set by POINTCHAIN_ARM) is 0;"),
        (
            "WORKSPACE__X_M",
            "0.1,0.2",
            "(set by POINTCHAIN_WORKSPACE__X_M) is '0.1,0.2'; it must be a list of 2 numbers",
        ),
        ("ARN__HOST", "x", "POINTCHAIN_ARN__HOST: unknown setting; did you mean POINTCHAIN_ARM?"),
    ],
)
def test_an_error_of_a_value_names_the_variable_that_set_it(
    name: str, value: str, expected: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(f"POINTCHAIN_{name}", value)
    assert expected in error_message()


def test_a_file_that_is_not_text_is_rejected(tmp_path: Path) -> None:
    path = tmp_path / "cell.toml"
    path.write_bytes(b"port = \xff")
    assert "it is not UTF-8 text" in error_message(path)
