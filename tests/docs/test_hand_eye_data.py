"""The files that the page on hand-eye data shows can be read."""

import json
from pathlib import Path

import numpy as np

from calibration.dataset.folder import read_folder, read_setup, write_view
from calibration.storage.hand_eye_file import load_hand_eye
from tests.docs.pages import DOCS, blocks

SETUP, POSE, HAND_EYE = (b.text for b in blocks(DOCS / "integrator/hand-eye-data.md") if b.language == "json")


def test_the_hand_eye_file_can_be_read(tmp_path: Path) -> None:
    file = tmp_path / "hand_eye.json"
    file.write_text(HAND_EYE)
    hand_eye = load_hand_eye(file, max_age_days=1e5)
    assert hand_eye.camera_id == json.loads(HAND_EYE)["camera_id"]
    assert hand_eye.warnings == ()


def test_the_folder_can_be_read(tmp_path: Path) -> None:
    (tmp_path / "setup.json").write_text(SETUP)
    setup = read_setup(tmp_path)
    assert setup.mounting == "eye-in-hand"
    assert setup.image_size == (1280, 800)
    write_view(tmp_path, "01", np.zeros((800, 1280), np.uint8), np.eye(4))
    (tmp_path / "01.json").write_text(POSE)
    content = read_folder(tmp_path)
    assert content.excluded == ()
    (view,) = content.views
    assert np.allclose(view.T_base_flange[:3, 3], json.loads(POSE)["T_base_flange"]["xyz_m"])
