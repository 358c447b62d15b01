"""What the README says of the configuration and of refusals is so."""

import json
import re
from pathlib import Path

from calibration.storage import load_hand_eye
from cell.arm_settings import URArm
from cell.camera_settings import OakCamera
from cell.recording_errors import RecordingError
from cell.settings import CellSettings, HandEyeSettings
from recognition.errors import RecognitionError
from service.config import ServiceConfig, load_config
from service.problems import TITLES

README = (Path(__file__).parents[1] / "README.md").read_text()


def blocks(language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", README, re.MULTILINE | re.DOTALL)


def test_the_values_told_for_what_is_left_out_are_the_defaults(tmp_path: Path) -> None:
    service, cell, simulated = blocks("toml")
    file = tmp_path / "cell.toml"

    file.write_text(service)
    loaded = load_config(file)
    assert loaded == ServiceConfig(data_dir=loaded.data_dir)

    file.write_text(cell)
    arm, camera = URArm(kind="ur", host="192.168.1.10"), OakCamera(kind="oak")
    kept = ServiceConfig().data_dir / "calibration"
    hand_eye = HandEyeSettings(file=tmp_path / "hand_eye.json", folder=kept)
    assert load_config(file).cell == CellSettings(arm=arm, camera=camera, hand_eye=hand_eye)
    # What is shown as a comment is taken too.
    file.write_text(re.sub(r"^# (?=\w+ = )", "", cell, flags=re.MULTILINE))
    assert load_config(file).scan.string_radius_m == 0.0042

    file.write_text(simulated)
    assert load_config(file).cell == CellSettings(hand_eye=HandEyeSettings(folder=kept))
    file.write_text(re.sub(r"^# (?=\w+ = )", "", simulated, flags=re.MULTILINE))
    assert load_config(file).arm.host == "127.0.0.3"


def test_the_hand_eye_file_can_be_read(tmp_path: Path) -> None:
    (example,) = (block for block in blocks("json") if "quat_xyzw" in block)
    file = tmp_path / "hand_eye.json"
    file.write_text(example)
    hand_eye = load_hand_eye(file, max_age_days=1e5)
    assert hand_eye.camera_id == json.loads(example)["camera_id"]
    assert hand_eye.warnings == ()


def test_what_to_do_is_told_for_each_type_of_problem() -> None:
    (table,) = re.findall(r"^\| do this \|.*?\n\n", README, re.MULTILINE | re.DOTALL)
    rows = [set(re.findall(r"`([a-z-]+)`", row)) - {"urn:pointchain:"} for row in table.splitlines()[2:]]
    told = set().union(*rows)
    assert set(TITLES) - told == set()
    elsewhere = {
        "bag",  # of a command
        "recording-exists",  # of a file that a command would write
        "recording-unreadable",  # a file that the service cannot read is `damaged`
        "invalid-scene",
        "invalid-gripper",  # both of the configuration, which is refused at the start
    }
    errors = (*RecordingError.__subclasses__(), *RecognitionError.__subclasses__())
    assert {error.slug for error in errors} - told - elsewhere == set()
