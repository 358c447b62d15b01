"""`pointchain import frames` makes a recording that gives the same model as the source of the depth images."""

import json
import re
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from calibration.geometry.transforms import inverse, to_quaternion
from cell.recording import Recording, read_recording
from cell.simulation.offline_scan import simulate, write_simulation
from cell.simulation.rendering.depth_camera import camera_model
from cell.simulation.scenes.scenes import make_scene
from service.cli.main import main
from service.processing.results import recognise_recording
from tests.service.intensity_images import with_intensity

Change = Callable[[Path], object]


@pytest.fixture(scope="module")
def twin(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a recording of a crossing from four sides by a noisy camera with wrong poses."""
    path = tmp_path_factory.mktemp("twin") / "twin.mcap"
    write_simulation(simulate(make_scene("loop", 2), camera_model("ideal", (320, 200)), 2, views=4), path)
    return path


@pytest.fixture(scope="module")
def recording(twin: Path) -> Recording:
    return read_recording(twin)


def write_folder(folder: Path, recording: Recording, pose: str = "T_base_camera") -> Path:
    """Write the depth images, `camera.json` and `poses.json` of a recording."""
    folder.mkdir()
    for view in recording.views:
        assert cv2.imwrite(str(folder / f"{view.index + 8}.png"), view.depth)  # 8, 9, 10, 11
    height, width = recording.views[0].depth.shape
    camera = {"width": width, "height": height, "K": recording.views[0].K.tolist()}
    (folder / "camera.json").write_text(json.dumps(camera))
    (folder / "poses.json").write_text(json.dumps([getattr(view, pose).tolist() for view in recording.views]))
    return folder


def read_png(path: Path) -> np.ndarray:
    depth = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    assert depth is not None
    return depth


def options(recording: Recording) -> list[str]:
    assert recording.header.workspace_m is not None
    box = [str(value) for side in recording.header.workspace_m for value in side]
    return ["--radius=0.0042", "--workspace", *box]


def hand_eye(folder: Path, recording: Recording) -> str:
    path = folder / "hand_eye.json"
    path.write_text(json.dumps({"T_flange_camera": recording.header.T_flange_camera.tolist()}))
    return f"--hand-eye={path}"


def assert_same_numbers(a: Any, b: Any) -> None:
    """Check that two documents are equal up to one unit in their last digit (a micrometre)."""
    if isinstance(a, dict):
        assert isinstance(b, dict)
        assert a.keys() == b.keys()
        for key, value in a.items():
            assert_same_numbers(value, b[key])
    elif isinstance(a, list):
        assert isinstance(b, list)
        assert len(a) == len(b)
        for one, other in zip(a, b, strict=True):
            assert_same_numbers(one, other)
    elif isinstance(a, float):
        assert a == pytest.approx(b, rel=0, abs=1.01e-6)
    else:
        assert a == b


def document(path: Path) -> dict[str, Any]:
    return replace(recognise_recording(path).model, timing_s={}, provenance=None).to_json()


def test_flange_poses_and_a_hand_eye_give_the_model_of_the_recording(
    twin: Path, recording: Recording, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder, out = write_folder(tmp_path / "in", recording, "T_base_flange"), tmp_path / "out.mcap"
    assert main(["import", "frames", str(folder), str(out), hand_eye(tmp_path, recording), *options(recording)]) == 0
    err = capsys.readouterr().err
    assert "4 depth images of 320x200 pixels, camera matrix: camera.json, poses: poses.json (T_base_flange)" in err
    assert "depth unit: 0.0001 m (guessed)" in err
    assert "warning" not in err
    assert f"wrote {out}" in err
    assert document(out) == document(twin)
    provenance = read_recording(out).header.provenance
    assert provenance["source"] == "depth images"
    assert provenance["folder"] == "in"
    assert provenance["depth_unit"] == "0.0001 m, guessed"
    # a second import gives the same bytes
    again = tmp_path / "again.mcap"
    assert main(["import", "frames", str(folder), str(again), hand_eye(tmp_path, recording), *options(recording)]) == 0
    assert again.read_bytes() == out.read_bytes()


def test_camera_poses_give_the_same_points(twin: Path, recording: Recording, tmp_path: Path) -> None:
    folder, out = write_folder(tmp_path / "in", recording), tmp_path / "out.mcap"
    assert main(["import", "frames", str(folder), str(out), *options(recording)]) == 0
    for view, wanted in zip(read_recording(out).views, recording.views, strict=True):
        np.testing.assert_array_equal(view.depth, wanted.depth)
        np.testing.assert_allclose(view.T_base_camera, wanted.T_base_camera, rtol=0, atol=1e-14)
    imported, original = document(out), document(twin)
    # The poses differ in the last bit, which may change the rounding of a number.
    assert_same_numbers(imported["chains"], original["chains"])
    assert_same_numbers(imported["crossings"], original["crossings"])


def test_one_image_gives_a_model_of_one_view(recording: Recording, tmp_path: Path) -> None:
    one = replace(recording, views=recording.views[1:2])
    folder, out = write_folder(tmp_path / "in", one), tmp_path / "out.mcap"
    assert main(["import", "frames", str(folder), str(out), *options(recording)]) == 0
    imported = document(out)
    assert [view["index"] for view in imported["quality"]["views"]] == [0]
    (chain,) = imported["chains"]
    assert max(chain["views"]) == 1
    assert "single-view" in {found["code"] for found in imported["quality"]["findings"]}


def to_npy(change: Callable[[np.ndarray], np.ndarray]) -> Change:
    def apply(folder: Path) -> None:
        for path in folder.glob("*.png"):
            np.save(path.with_suffix(".npy"), change(read_png(path)))
            path.unlink()

    return apply


def poses_by(form: Callable[[np.ndarray], Any]) -> Change:
    def apply(folder: Path) -> None:
        poses = [form(np.array(T)) for T in json.loads((folder / "poses.json").read_text())]
        (folder / "poses.json").write_text(json.dumps(poses))

    return apply


def poses_beside(suffix: str, write: Callable[[Path, np.ndarray], Any]) -> Change:
    def apply(folder: Path) -> None:
        for k, T in enumerate(json.loads((folder / "poses.json").read_text())):
            write(folder / f"{k + 8}{suffix}", np.array(T))
        (folder / "poses.json").unlink()

    return apply


def poses_by_name(folder: Path) -> None:
    poses = json.loads((folder / "poses.json").read_text())
    named = {f"{k + 8}{'.png' if k % 2 else ''}": {"T_base_camera": T} for k, T in enumerate(poses)}
    (folder / "poses.json").write_text(json.dumps(dict(reversed(named.items()))))


def rotation_vector(T: np.ndarray) -> dict[str, Any]:
    return {"xyz_m": T[:3, 3].tolist(), "rotvec_rad": cv2.Rodrigues(T[:3, :3])[0].ravel().tolist()}


def camera_as_bare_matrix(folder: Path) -> None:
    (folder / "K.json").write_text(json.dumps(json.loads((folder / "camera.json").read_text())["K"]))
    (folder / "camera.json").unlink()


def with_notes(folder: Path) -> None:
    (folder / "README.md").write_text("ours")
    (folder / "notes.txt").write_text("of Monday")
    (folder / ".hidden.jpg").write_bytes(b"")
    (folder / "colour").mkdir()


@pytest.mark.parametrize(
    "change",
    [
        to_npy(lambda depth: depth),
        to_npy(lambda depth: depth.astype(np.int32)),
        to_npy(lambda depth: np.where(depth > 0, depth * 1e-4, np.nan)),
        to_npy(lambda depth: (depth * np.float32(0.1)).astype(np.float32)),  # millimetres
        poses_by(lambda T: {"xyz_m": T[:3, 3].tolist(), "quat_xyzw": to_quaternion(T).tolist()}),
        poses_by(rotation_vector),
        poses_by(lambda T: {"T_base_camera": T.tolist(), "held_out": False}),
        poses_by_name,
        poses_beside(".json", lambda path, T: path.write_text(json.dumps({"T_base_camera": T.tolist()}))),
        poses_beside(".txt", np.savetxt),
        poses_beside(".txt", lambda path, T: np.savetxt(path, T, delimiter=",")),
        camera_as_bare_matrix,
        with_notes,
    ],
)
def test_every_form_gives_the_same_views(recording: Recording, tmp_path: Path, change: Change) -> None:
    folder, out = write_folder(tmp_path / "in", recording), tmp_path / "out.mcap"
    change(folder)
    assert main(["import", "frames", str(folder), str(out)]) == 0
    imported = read_recording(out)
    for view, wanted in zip(imported.views, recording.views, strict=True):
        np.testing.assert_allclose(view.depth * view.depth_unit_m, wanted.depth * wanted.depth_unit_m, atol=1e-8)
        np.testing.assert_allclose(view.T_base_camera, wanted.T_base_camera, rtol=0, atol=1e-12)
        np.testing.assert_array_equal(view.K, wanted.K)


def test_images_of_two_units_are_rejected(
    recording: Recording, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder, out = write_folder(tmp_path / "in", recording), tmp_path / "out.mcap"
    for name in ("8.png", "9.png"):
        cv2.imwrite(str(folder / name), np.rint(read_png(folder / name) / 10).astype(np.uint16))  # 0.001 m a count
    assert main(["import", "frames", str(folder), str(out)]) == 1
    err = capsys.readouterr().err
    assert "several put pixels at the table, z = 0 m: 0.001 m (" in err
    assert " and 0.0001 m (" in err
    assert not out.exists()


def test_columns_of_two_units_are_rejected(
    recording: Recording, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Scale every other column, which a sample with a fixed stride could miss."""
    folder, out = write_folder(tmp_path / "in", recording), tmp_path / "out.mcap"
    for path in folder.glob("*.png"):
        depth = read_png(path)
        depth[:, ::2] = np.rint(depth[:, ::2] / 10)
        cv2.imwrite(str(path), depth)
    assert main(["import", "frames", str(folder), str(out)]) == 1
    assert "several put pixels at the table" in capsys.readouterr().err


def test_a_given_unit_is_used_without_a_guess(
    recording: Recording, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder, out = write_folder(tmp_path / "in", recording), tmp_path / "out.mcap"
    for path in folder.glob("*.png"):
        cv2.imwrite(str(path), read_png(path) // 3)
    assert main(["import", "frames", str(folder), str(out), "--depth-unit=0.0003"]) == 0
    assert "depth unit: 0.0003 m (given)" in capsys.readouterr().err
    assert read_recording(out).header.depth_unit_m == 0.0003


def test_a_given_unit_that_does_not_fit_the_table_causes_a_warning(
    recording: Recording, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder, out = write_folder(tmp_path / "in", recording), tmp_path / "out.mcap"
    camera = json.loads((folder / "camera.json").read_text())
    (folder / "camera.json").write_text(json.dumps(camera | {"depth_unit_m": 0.0001}))
    assert main(["import", "frames", str(folder), str(out), "--depth-unit=0.001", *options(recording)]) == 0
    err = capsys.readouterr().err
    assert "depth unit: 0.001 m (given, though camera.json has 0.0001 m); with it, 0% of the pixels" in err
    assert "warning: fewer than 30% of the pixels are at the table: check the depth unit (0.0001 m would fit)" in err


@pytest.mark.parametrize(("table_z_m", "warned"), [(0.0, False), (-0.001, False), (0.007, True), (-0.005, True)])
def test_a_table_at_another_height_is_measured(
    recording: Recording, tmp_path: Path, capsys: pytest.CaptureFixture[str], table_z_m: float, warned: bool
) -> None:
    """Check the measured height. The table is at z = 0; a hand-eye error of 0.15 degrees moves it 1.3 mm at 0.5 m."""
    folder, out = write_folder(tmp_path / "in", recording), tmp_path / "out.mcap"
    assert main(["import", "frames", str(folder), str(out), f"--table-z={table_z_m}"]) == 0
    err = capsys.readouterr().err
    assert ("warning" in err) == warned
    if warned:
        measured_m = float(err.split("show the table at z = ")[1].split(" m")[0])
        assert abs(measured_m) < 0.002


@pytest.mark.parametrize("table_z_m", [0.02, -0.12])
def test_a_table_far_from_the_given_height_is_measured_if_the_unit_is_given(
    recording: Recording, tmp_path: Path, capsys: pytest.CaptureFixture[str], table_z_m: float
) -> None:
    folder, out = write_folder(tmp_path / "in", recording), tmp_path / "out.mcap"
    assert main(["import", "frames", str(folder), str(out), f"--table-z={table_z_m}", "--depth-unit=0.0001"]) == 0
    err = capsys.readouterr().err
    assert f"not {table_z_m:g} m: measure the height" in err
    assert abs(float(err.split("show the table at z = ")[1].split(" m")[0])) < 0.002


def test_a_radius_in_millimetres_is_rejected(
    recording: Recording, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder, out = write_folder(tmp_path / "in", recording), tmp_path / "out.mcap"
    assert main(["import", "frames", str(folder), str(out), "--radius=4.2"]) == 1
    assert "the string radius is 4.2 m; it must be from 0.0005 to 0.02 m (metres, not mm)" in capsys.readouterr().err
    assert not out.exists()


def test_the_recording_holds_the_options(recording: Recording, tmp_path: Path) -> None:
    folder, out = write_folder(tmp_path / "in", recording), tmp_path / "out.mcap"
    (folder / "camera.json").unlink()
    K = recording.views[0].K
    numbers = [str(value) for value in (K[0, 0], K[1, 1], K[0, 2], K[1, 2])]
    assert main(["import", "frames", str(folder), str(out), "--intrinsics", *numbers, *options(recording)]) == 0
    header = read_recording(out).header
    assert (header.string_radius_m, header.workspace_m) == (0.0042, recording.header.workspace_m)
    assert header.provenance["intrinsics"] == "--intrinsics"
    np.testing.assert_array_equal(read_recording(out).views[0].K, K)


def rewrite(name: str, change: Callable[[Any], Any]) -> Change:
    def apply(folder: Path) -> None:
        (folder / name).write_text(json.dumps(change(json.loads((folder / name).read_text()))))

    return apply


def image(change: Callable[[np.ndarray], np.ndarray], name: str = "9.png") -> Change:
    def apply(folder: Path) -> None:
        depth = read_png(folder / name)
        assert cv2.imwrite(str(folder / name), change(depth))

    return apply


def images(change: Callable[[np.ndarray], np.ndarray]) -> Change:
    return lambda folder: [image(change, path.name)(folder) for path in folder.glob("*.png")]


def remove(*names: str) -> Change:
    return lambda folder: [(folder / name).unlink() for name in names]


def more_images(count: int) -> Change:
    """Add copies of an image."""
    return lambda folder: [shutil.copy(folder / "8.png", folder / f"{12 + k}.png") for k in range(count)]


def both(*changes: Change) -> Change:
    return lambda folder: [change(folder) for change in changes]


def cut_off(folder: Path) -> None:
    content = (folder / "9.png").read_bytes()
    (folder / "9.png").write_bytes(content[: len(content) // 2])


def flip_byte(folder: Path) -> None:
    content = bytearray((folder / "9.png").read_bytes())
    content[len(content) // 2] ^= 0xFF
    (folder / "9.png").write_bytes(bytes(content))


def npy(change: Callable[[np.ndarray], np.ndarray]) -> Change:
    return to_npy(lambda depth: change(depth.astype(np.float64) * 1e-4))


def one_entry(row: int, column: int, value: float) -> Change:
    def change(poses: list[Any]) -> list[Any]:
        poses[1][row][column] = value
        return poses

    return rewrite("poses.json", change)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (rewrite("poses.json", lambda poses: poses[:-1]), "3 poses, the folder 4 depth images: 11.png has no pose"),
        (
            rewrite("poses.json", lambda poses: [*poses, poses[0]]),
            "5 poses, the folder 4 depth images: remove the poses",
        ),
        (rewrite("poses.json", lambda poses: dict(zip(("8", "9", "10"), poses, strict=False))), "no pose for 11.png"),
        (
            rewrite("poses.json", lambda poses: dict(zip(map(str, range(8, 13)), [*poses, poses[0]], strict=True))),
            "a pose for 12, which is no depth image",
        ),
        (remove("poses.json"), "has no poses: add poses.json, or a file beside each image, as 8.json or 8.txt"),
        (rewrite("poses.json", lambda _: 7), "must be a list of poses in the order of the images, or an object"),
        (one_entry(0, 3, float("nan")), "pose 1 (9.png) is not a pose"),
        (one_entry(0, 0, 2.0), "pose 1 (9.png) is not a pose: the transform is not rigid"),
        (one_entry(0, 3, 412.0), "these look like millimetres"),
        (rewrite("poses.json", lambda p: [{"T_base_flange": T} for T in p]), "for flange poses give --hand-eye"),
        (poses_by(lambda T: inverse(T).tolist()), "these look like T_camera_base; invert them"),
        (poses_by(lambda T: (np.diag([1, 1, -1, 1]) @ T @ np.diag([-1, 1, 1, 1])).tolist()), "below the table"),
        (poses_by(lambda T: (T @ np.diag([1, -1, -1, 1])).tolist()), "the camera looks away from the table"),
        (poses_by(lambda T: {**rotation_vector(T), "quat_xyzw": [0, 0, 0, 1]}), "gives the rotation twice"),
        (remove("camera.json"), "has no camera.json"),
        (
            rewrite("camera.json", lambda c: c | {"width": 640}),
            "for images of 640x200 pixels, the depth images have 320x200",
        ),
        (
            rewrite("camera.json", lambda c: c | {"K": [[500, 0, 640], [0, 500, 400], [0, 0, 1]]}),
            "outside the depth images",
        ),
        (
            rewrite("camera.json", lambda c: c | {"K": [[500, 1, 160], [0, 500, 100], [0, 0, 1]]}),
            "not a pinhole matrix",
        ),
        (rewrite("camera.json", lambda c: c | {"K": [500, 500, 160, 100]}), "K must be 3 rows of 3 finite numbers"),
        (rewrite("camera.json", lambda c: c | {"distortion": [0.1, 0, 0, 0]}), "has lens distortion (distortion)"),
        (rewrite("camera.json", lambda c: c | {"scale": 1000}), "the member 'scale', which is not known here"),
        (
            both(camera_as_bare_matrix, lambda f: (f / "camera.json").write_text("{}")),
            "both camera.json and K.json",
        ),
        (lambda folder: (folder / "camera.json").write_text("{"), "camera.json is not JSON"),
        (
            images(lambda depth: depth // 3),
            "the depth unit is not given, and no common one puts the table at z = 0 m",
        ),
        (image(lambda depth: (depth // 256).astype(np.uint8)), "9.png has 8 bits a pixel"),
        (image(lambda depth: np.dstack([depth] * 3)), "9.png is colour (RGB), not depth"),
        (image(lambda depth: depth[:100]), "9.png has 320x100 pixels, 8.png 320x200"),
        (image(lambda depth: depth * 0), "9.png has no pixel with a depth"),
        (cut_off, "9.png is damaged or cut off"),
        (flip_byte, "9.png is damaged or cut off"),
        (lambda folder: (folder / "9.png").write_text("no image"), "9.png is not a PNG image"),
        (lambda folder: (folder / "9.jpg").write_bytes(b""), "9.jpg is a JPEG picture"),
        (lambda folder: (folder / "9.raw").write_bytes(b""), "9.raw is not in a format that is read here"),
        (lambda folder: np.save(folder / "9.npy", np.ones((200, 320))), "holds both .png and .npy files"),
        (npy(lambda depth: depth * np.nan), "has no pixel with a depth (all are 0 or NaN)"),
        (npy(lambda depth: -depth), "negative depths"),
        (npy(lambda depth: np.dstack([depth] * 3)), "as a colour image has; (height, width) is needed"),
        (npy(lambda depth: depth.astype(complex)), "holds complex128; integers or floats are needed"),
        (npy(lambda depth: depth * 1234567), "which metres cannot be"),
        (
            both(to_npy(lambda d: d), lambda f: np.save(f / "9.npy", np.ones((200, 320)))),
            "integers and floats have different",
        ),
        (both(to_npy(lambda d: d), lambda f: (f / "9.npy").write_bytes(b"no")), "9.npy is not an NPY array"),
        (more_images(61), "holds 65 depth images; a recording takes at most 64 views"),
        (remove("8.png", "9.png", "10.png"), "has 4 poses, the folder 1 depth images"),
        (remove("8.png", "9.png", "10.png", "11.png"), "holds no depth images"),
        (
            both(poses_beside(".txt", np.savetxt), remove("9.png")),
            "9.txt holds a pose, and there is no depth image 9",
        ),
        (both(poses_beside(".txt", np.savetxt), remove("9.txt")), "9.png has no pose: add 9.json"),
        (poses_beside(".txt", lambda path, T: np.savetxt(path, T[:3])), "8.txt is not a pose: 4 rows of 4 numbers"),
    ],
)
def test_bad_input_is_rejected_and_nothing_is_written(
    recording: Recording, tmp_path: Path, change: Change, message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    folder, out = write_folder(tmp_path / "in", recording), tmp_path / "out" / "out.mcap"
    out.parent.mkdir()
    change(folder)
    assert main(["import", "frames", str(folder), str(out)]) == 1
    err = capsys.readouterr().err
    assert message in err
    assert err.startswith("pointchain import frames: ")
    assert err.count("\n") == 1
    assert list(out.parent.iterdir()) == []


@pytest.mark.parametrize("table_z_m", [0.08, -0.12])
def test_a_table_at_another_height_is_named(
    recording: Recording, tmp_path: Path, table_z_m: float, capsys: pytest.CaptureFixture[str]
) -> None:
    folder, out = write_folder(tmp_path / "in", recording), tmp_path / "out.mcap"
    assert main(["import", "frames", str(folder), str(out), "--table-z", str(table_z_m)]) == 1
    assert re.search(
        r"the images show a level plane at z = -?0\.00\d\d m with 0\.0001 m per count: if this is the table, give",
        capsys.readouterr().err,
    )
    assert not out.exists()


def test_a_single_image_may_show_a_plane_with_several_units(
    recording: Recording, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder, out = write_folder(tmp_path / "in", recording), tmp_path / "out.mcap"
    remove("9.png", "10.png", "11.png")(folder)
    poses = json.loads((folder / "poses.json").read_text())
    (folder / "poses.json").write_text(json.dumps(poses[:1]))
    assert main(["import", "frames", str(folder), str(out), "--table-z", "0.08"]) == 1
    err = capsys.readouterr().err
    heights = {unit: float(z_m) for z_m, unit in re.findall(r"at z = (-?[\d.]+) m with ([\d.]+) m per count", err)}
    assert len(heights) > 1
    assert abs(heights["0.0001"]) < 0.002


def test_inverted_flange_poses_are_recognised(
    recording: Recording, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = write_folder(tmp_path / "in", recording, "T_base_flange")
    poses_by(lambda T: inverse(T).tolist())(folder)
    assert main(["import", "frames", str(folder), str(tmp_path / "o.mcap"), hand_eye(tmp_path, recording)]) == 1
    assert "these look like T_flange_base; invert them, T_base_flange is needed" in capsys.readouterr().err


def test_nothing_is_overwritten_and_a_folder_is_needed(
    recording: Recording, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder, out = write_folder(tmp_path / "in", recording), tmp_path / "out.mcap"
    out.write_text("mine")
    assert main(["import", "frames", str(folder), str(out)]) == 1
    assert "exists already; nothing is overwritten" in capsys.readouterr().err
    assert out.read_text() == "mine"
    assert main(["import", "frames", str(tmp_path / "none"), str(tmp_path / "new.mcap")]) == 1
    assert "is not a folder: name the folder that holds the depth images" in capsys.readouterr().err
    assert main(["import", "frames", str(tmp_path), str(tmp_path / "new.mcap")]) == 1
    assert "it holds the folders in: name the one with the images" in capsys.readouterr().err
    assert main(["import", "frames", str(folder), str(tmp_path / "no" / "new.mcap")]) == 1
    assert "cannot be written: No such file or directory" in capsys.readouterr().err


def write_intensities(folder: Path, recording: Recording) -> Path:
    folder.mkdir()
    for view in recording.views:
        intensity = with_intensity(view).intensity
        assert intensity is not None
        assert cv2.imwrite(str(folder / f"{view.index + 8}.png"), intensity)
    return folder


def test_intensity_images_are_imported(recording: Recording, tmp_path: Path) -> None:
    folder = write_folder(tmp_path / "in", recording)
    # A subfolder of the depth images is ignored unless it is named.
    left = write_intensities(folder / "left", recording)
    for name, options_ in (("without.mcap", []), ("with.mcap", [f"--intensity={left}"])):
        given = [*options(recording), *options_]
        assert main(["import", "frames", str(folder), str(tmp_path / name), *given]) == 0
    assert all(view.intensity is None for view in read_recording(tmp_path / "without.mcap").views)
    for got, wanted in zip(read_recording(tmp_path / "with.mcap").views, recording.views, strict=True):
        np.testing.assert_array_equal(got.intensity, with_intensity(wanted).intensity)
    assert document(tmp_path / "with.mcap") == document(tmp_path / "without.mcap")


def enlarge(left: Path) -> None:
    assert cv2.imwrite(str(left / "9.png"), np.zeros((200, 640), np.uint8))


def colour(left: Path) -> None:
    assert cv2.imwrite(str(left / "9.png"), np.zeros((200, 320, 3), np.uint8))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (shutil.rmtree, r"left is not a folder: name the folder that holds the intensity images"),
        (lambda left: (left / "9.png").unlink(), r"9\.png is missing: each depth image needs an intensity image"),
        (enlarge, r"9\.png has 640x200 pixels, the depth images have 320x200: intensity images must be aligned"),
        (colour, r"9\.png has pixels of the kind RGB: save it as an 8-bit grey PNG"),
        (lambda left: (left / "9.png").write_bytes(b"GIF89a"), r"9\.png is not a PNG image"),
        (
            lambda left: (left / "9.png").write_bytes((left / "9.png").read_bytes()[:-2000]),
            r"9\.png is damaged or cut off",
        ),
    ],
)
def test_intensity_images_that_cannot_be_used_are_refused(
    recording: Recording, tmp_path: Path, capsys: pytest.CaptureFixture[str], change: Change, message: str
) -> None:
    folder = write_folder(tmp_path / "in", recording)
    left = write_intensities(tmp_path / "left", recording)
    change(left)
    out = tmp_path / "out.mcap"
    assert main(["import", "frames", str(folder), str(out), f"--intensity={left}", *options(recording)]) == 1
    assert re.search(message, capsys.readouterr().err)
    assert not out.exists()
