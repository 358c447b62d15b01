"""The command line: stdout, stderr and exit code of the commands."""

import json
import re
import socket
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from calibration.geometry.transforms import from_rotation_vector
from cell.config.cell_config import CellSettings
from cell.config.gripper_config import GripperSettings
from cell.kinematics.ur_kinematics import forward
from cell.recording import RecordingHeader, RecordingWriter, read_recording
from cell.simulation.devices.world import simulated_world
from cell.simulation.offline_scan import simulate, write_simulation
from cell.simulation.rendering.depth_camera import camera_model
from cell.simulation.scenes.scenes import make_scene
from recognition.pipeline import recognise
from recognition.preprocessing import Scene
from recognition.request import RecognitionRequest
from service.app import openapi_document
from service.cli.commands.demo import describe_best_grasp, indented
from service.cli.main import main
from service.processing.reach_finder import ReachFinder
from service.processing.worker import TaskFailedError
from service.storage.data_folder import DataFolder
from tests.docs.outputs import LOOSE, differences, shown_after


def run(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, list[dict[str, Any]], str]:
    """Return the exit code, the documents on stdout, and stderr."""
    code = main([str(argument) for argument in arguments])
    out, err = capsys.readouterr()
    return code, [json.loads(line) for line in out.splitlines()], err


def write(path: Path, header: RecordingHeader, views: Any) -> Path:
    with RecordingWriter(path, header) as writer:
        for view in views:
            writer.write_view(view)
    return path


def test_recognise_prints_one_model_per_line(capsys: pytest.CaptureFixture[str], recording_file: Path) -> None:
    code, models, _ = run(capsys, "recognise", recording_file, recording_file)
    assert code == 0
    assert [len(model["chains"]) for model in models] == [1, 1]
    assert models[0]["chains"] == models[1]["chains"], "the same file gives the same model"
    assert models[0]["method"] == "graph"
    assert models[0]["parameters"]["r_m"] == 0.0042


def test_recognise_prints_nothing_else_for_an_accepted_model(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    path = tmp_path / "arc.mcap"
    write_simulation(simulate(make_scene("arc", 3), camera_model("exact", (320, 200)), 3, views=4), path)
    code, (model,), err = run(capsys, "recognise", path)
    assert (code, err) == (0, "")
    assert model["quality"]["verdict"] == "accept"
    assert model["chains"][0]["trust"] == "accept"


def test_recognise_prints_the_verdict_and_the_doubts(capsys: pytest.CaptureFixture[str], recording_file: Path) -> None:
    """With 6 mm as radius of the string of 4.2 mm, the model has a doubt about its only chain."""
    code, (model,), err = run(capsys, "recognise", recording_file, "--radius", "0.006")
    assert code == 0
    quality = model["quality"]
    doubts = [found for found in quality["findings"] if found["severity"] != "note"]
    assert (quality["verdict"], doubts[0]["code"], doubts[0]["chains"]) == ("review", "radius-much-smaller", [0])
    assert [line.split(f"{recording_file}: ", 1)[1] for line in err.splitlines()] == [
        "verdict: review",
        *(f"{found['severity']}: {found['message']} [{found['code']}]" for found in doubts),
    ]


def test_recognise_lists_untrusted_grasps_on_request(capsys: pytest.CaptureFixture[str], recording_file: Path) -> None:
    arguments = ("recognise", recording_file, "--radius", "0.006")
    _, (model,), _ = run(capsys, *arguments)
    assert (model["grasps"], "all_grasps" in model["request"]) == ([], False)
    _, (model,), _ = run(capsys, *arguments, "--all-grasps")
    assert len(model["grasps"]) > 50
    assert not any(grasp["trusted"] for grasp in model["grasps"])
    assert model["request"]["all_grasps"] is True
    _, (model,), _ = run(capsys, "recognise", recording_file, "--all-grasps")
    assert all(grasp["trusted"] for grasp in model["grasps"]), "no doubt concerns the chain"


def test_recognise_continues_after_a_bad_file(
    capsys: pytest.CaptureFixture[str], recording_file: Path, tmp_path: Path
) -> None:
    bad = tmp_path / "bad.mcap"
    bad.write_bytes(b"not a recording at all")
    code, (first, second), err = run(capsys, "recognise", bad, recording_file)
    assert code == 1
    assert first["schema"] == "pointchain/2"
    assert first["error"]["type"] == "urn:pointchain:not-mcap"
    assert str(bad) in first["error"]["file"]
    assert "bad.mcap" in err
    assert len(second["chains"]) == 1


@pytest.mark.parametrize(
    ("name", "content", "slug"),
    [("empty", b"", "not-mcap"), ("text", b"hello", "not-mcap"), ("missing", None, "recording-unreadable")],
)
def test_a_file_that_is_not_a_recording_is_rejected(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, name: str, content: bytes | None, slug: str
) -> None:
    path = tmp_path / f"{name}.mcap"
    if content is not None:
        path.write_bytes(content)
    code, (document,), err = run(capsys, "recognise", path)
    assert code == 1
    assert document["error"]["type"] == f"urn:pointchain:{slug}"
    assert name in err


@pytest.mark.parametrize("radius", ["0", "-0.004", "0.0001", "0.1", "nan", "inf"])
def test_an_impossible_radius_is_rejected(
    capsys: pytest.CaptureFixture[str], recording_file: Path, radius: str
) -> None:
    code, (document,), err = run(capsys, "recognise", recording_file, f"--radius={radius}")
    assert code == 1
    assert document["error"]["type"] == "urn:pointchain:invalid-parameters"
    assert "radius" in err


def test_an_unknown_radius_is_measured(
    capsys: pytest.CaptureFixture[str], recording_file: Path, tmp_path: Path
) -> None:
    recording = read_recording(recording_file)
    path = write(tmp_path / "r.mcap", replace(recording.header, string_radius_m=None), recording.views)
    code, (document,), _ = run(capsys, "recognise", path)
    assert code == 0
    (chain,) = document["chains"]
    assert chain["radius_m"] == pytest.approx(0.0042, rel=0.05)


def test_one_view_is_recognised(capsys: pytest.CaptureFixture[str], recording_file: Path, tmp_path: Path) -> None:
    recording = read_recording(recording_file)
    path = write(tmp_path / "one.mcap", recording.header, recording.views[:1])
    code, (document,), _ = run(capsys, "recognise", path)
    assert code == 0
    (chain,) = document["chains"]
    assert max(chain["views"]) == 1
    assert "single-view" in {found["code"] for found in document["quality"]["findings"]}


def test_views_without_depth_are_rejected(
    capsys: pytest.CaptureFixture[str], recording_file: Path, tmp_path: Path
) -> None:
    recording = read_recording(recording_file)
    dark = [replace(view, depth=np.zeros_like(view.depth)) for view in recording.views]
    code, (document,), err = run(capsys, "recognise", write(tmp_path / "dark.mcap", recording.header, dark))
    assert code == 1
    assert document["error"]["type"] == "urn:pointchain:no-depth"
    assert "no pixel has a depth" in err


def test_a_constant_view_is_excluded_and_reported(
    capsys: pytest.CaptureFixture[str], recording_file: Path, tmp_path: Path
) -> None:
    recording = read_recording(recording_file)
    stuck = replace(recording.views[1], depth=np.full_like(recording.views[1].depth, 3000))
    views = [recording.views[0], stuck, *recording.views[2:]]
    code, (model,), _ = run(capsys, "recognise", write(tmp_path / "stuck.mcap", recording.header, views))
    assert code == 0
    assert [view["used"] for view in model["quality"]["views"]] == [True, False, True, True]
    assert "same depth" in model["quality"]["views"][1]["reason"]
    assert len(model["chains"]) == 1


def test_no_string_in_view_is_a_valid_empty_model(
    capsys: pytest.CaptureFixture[str], recording_file: Path, tmp_path: Path
) -> None:
    recording = read_recording(recording_file)
    # the string does not lie on this part of the table
    beside = replace(recording.header, workspace_m=((-0.2, -0.12), (-0.2, -0.12), (0.0, 0.1)))
    code, (model,), _ = run(capsys, "recognise", write(tmp_path / "none.mcap", beside, recording.views))
    assert code == 0
    assert model["chains"] == model["crossings"] == []
    (empty,) = [found for found in model["quality"]["findings"] if found["code"] == "no-string-in-view"]
    assert empty["severity"] == "note"
    assert "no string of this radius in view" in empty["message"]


def test_a_workspace_without_depth_is_rejected(
    capsys: pytest.CaptureFixture[str], recording_file: Path, tmp_path: Path
) -> None:
    recording = read_recording(recording_file)
    nowhere = replace(recording.header, workspace_m=((5.0, 6.0), (5.0, 6.0), (0.0, 0.1)))
    code, (document,), err = run(capsys, "recognise", write(tmp_path / "off.mcap", nowhere, recording.views))
    assert code == 1
    assert document["error"]["type"] == "urn:pointchain:no-depth"
    assert "workspace" in err


def test_a_truncated_recording_gives_a_model_or_an_error(
    capsys: pytest.CaptureFixture[str], recording_file: Path, tmp_path: Path
) -> None:
    whole = recording_file.read_bytes()
    files = []
    for k, length in enumerate(np.random.default_rng(5).integers(0, len(whole), 50)):
        files.append(tmp_path / f"{k}.mcap")
        files[-1].write_bytes(whole[:length])
    code, documents, _ = run(capsys, "recognise", *files)
    assert len(documents) == 50
    failed = [document for document in documents if "error" in document]
    assert code == bool(failed)
    for document in documents:
        if "error" not in document:
            assert len(document["chains"]) == 1
            # a cut in the index after the last view loses no data
            lost = len(document["quality"]["views"]) < 4
            findings = document["quality"]["findings"]
            notes = [found["message"] for found in findings if found["code"] == "recording-incomplete"]
            assert lost == any("file ends" in message for message in notes)
    # with four views of about equal size, a cut after the second view leaves enough for a model
    assert 10 < len(failed) < 40


@pytest.mark.parametrize(
    ("share", "code", "expected"),
    [
        (0.05, 1, "has no complete view: it has no message of any view; the recording is cut off, copy the file again"),
        (
            0.35,
            0,
            "the recording is cut off: it has 1 complete view, and anything after view 0 is lost; scan again",
        ),
        (
            0.75,
            0,
            "the recording is cut off: it has 2 complete views, and anything after view 1 is lost; scan again",
        ),
    ],
)
def test_a_truncated_recording_is_reported_with_what_is_left(
    capsys: pytest.CaptureFixture[str], recording_file: Path, tmp_path: Path, share: float, code: int, expected: str
) -> None:
    whole, cut = recording_file.read_bytes(), tmp_path / "cut.mcap"
    cut.write_bytes(whole[: int(len(whole) * share)])
    exit_code, (document,), stderr = run(capsys, "recognise", cut)
    assert exit_code == code
    assert expected in stderr
    assert expected in json.dumps(document)
    if code == 0:
        incomplete = [found for found in document["quality"]["findings"] if found["code"] == "recording-incomplete"]
        assert any(expected in found["message"] for found in incomplete)
        assert len(document["chains"]) == 1


def test_trace_draws_every_stage(capsys: pytest.CaptureFixture[str], recording_file: Path, tmp_path: Path) -> None:
    code, _, _ = run(capsys, "recognise", recording_file, "--trace", tmp_path)
    assert code == 0
    pictures = sorted((tmp_path / recording_file.stem).iterdir())
    drawn = [picture.name for picture in pictures]
    assert (drawn[0], drawn[3], drawn[-1]) == ("01_target_cloud.png", "04_nodes.png", "08_model.png")
    assert all(picture.read_bytes().startswith(b"\x89PNG") for picture in pictures)
    run(capsys, "recognise", recording_file, "--trace", tmp_path, "--method", "matching")
    drawn = sorted(picture.name for picture in (tmp_path / recording_file.stem).iterdir())
    assert (len(drawn), drawn[-1]) == (5, "05_model.png")
    assert "04_nodes.png" not in drawn, "pictures of another method are removed"


def test_simulate_writes_the_same_file_for_the_same_seed(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    options = ("--scene", "loop", "--camera", "ideal", "--resolution", "160x100", "--views", "2")
    for name, seed in (("a", 3), ("b", 3), ("c", 4)):
        code, _, err = run(capsys, "simulate", tmp_path / f"{name}.mcap", *options, "--seed", seed)
        assert code == 0, err
    a, b, c = ((tmp_path / f"{name}.mcap").read_bytes() for name in "abc")
    assert a == b
    assert a != c
    truth = json.loads((tmp_path / "a.truth.json").read_text())
    assert len(truth["crossings"]) == 1


def test_simulate_renders_the_given_surfaces(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    camera = ("--camera", "oak-d-pro", "--resolution", "96x60", "--views", "1", "--no-image-cache")
    surfaces = ("--sheath", "woven", "--table-top", "grained", "--ir-dots", "0.4")
    code, _, err = run(capsys, "simulate", tmp_path / "a.mcap", *camera, *surfaces)
    assert code == 0, err
    provenance = read_recording(tmp_path / "a.mcap").header.provenance
    assert (provenance["sheath"], provenance["table_top"], provenance["ir_dots"]) == ("woven", "grained", "0.4")


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (("--scene", "knot"), "overhand-knot"),
        (("--camera", "ideal", "--resolution", "100x10"), "choose a size from 32x20 to 1280x800"),
        (
            ("--camera", "ideal", "--sheath", "woven"),
            "sheath cannot be set for ideal, which renders no images: choose oak-d-pro",
        ),
        (("--camera", "oak-d-pro", "--ir-dots", "2"), "ir_dots is 2; from 0 to 1 is allowed"),
        (("--camera", "oak-d-sr", "--ir-dots", "0.5"), "oak-d-sr has no dot projector"),
        (("--radius", "1"), "radius"),
        (("--radius", "4.2"), "metres are expected, and 4.2 looks like millimetres"),
        (("--softness", "0.1"), "softness"),
        (("--views", "0"), "views"),
        (("--seed", "-1"), "seed"),
    ],
)
def test_simulate_reports_what_is_wrong(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, arguments: tuple[str, ...], expected: str
) -> None:
    code, _, err = run(capsys, "simulate", tmp_path / "x.mcap", *arguments)
    assert code == 1
    assert expected in err
    assert list(tmp_path.iterdir()) == [], "no incomplete file remains"


def test_simulate_never_overwrites(capsys: pytest.CaptureFixture[str], recording_file: Path) -> None:
    before = recording_file.read_bytes()
    code, _, err = run(capsys, "simulate", recording_file)
    assert code == 1
    assert recording_file.name in err
    assert recording_file.read_bytes() == before


def test_simulate_into_a_missing_folder_is_rejected(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    code, _, err = run(capsys, "simulate", tmp_path / "none" / "x.mcap", "--camera", "exact", "--views", "1")
    assert code == 1
    assert "x.mcap cannot be written: No such file or directory" in err


def test_demo_compares_with_the_truth_and_can_be_repeated(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    folder = tmp_path / "demo"
    for name in ("scan.mcap", "scan.truth.json", "result/old.json", "trace/old.png"):  # files of an earlier demo
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text("old")
    assert main(["demo", str(folder)]) == 0
    out = capsys.readouterr().out
    assert "topology right" in out
    model = json.loads((folder / "result" / "model.json").read_text())
    quality = model["quality"]
    assert f"\nVerdict            {quality['verdict']}\n" in out
    for found in quality["findings"]:
        assert f"\n{found['severity'].capitalize():19}{found['message']}\n" in out
    assert str(folder / "scan.mcap") in out
    assert len(list(tmp_path.glob("cache/pointchain/simulated-images/*.npz"))) >= 8, "rendered images are kept"
    assert not list(folder.rglob("old.*"))
    assert len(model["crossings"]) == 1
    check_best_grasp(out, model)
    text = (folder / "result" / "model.json").read_text()
    assert '\n  "chains": [\n' in text, "it is indented"
    assert re.search(r"^ +\[-?[0-9.]+, -?[0-9.]+, -?[0-9.]+\],$", text, re.MULTILINE), "a point has one line"
    pictures = sorted(path.name for path in (folder / "trace").iterdir())
    assert (pictures[0], pictures[3], pictures[-1]) == ("01_target_cloud.png", "04_nodes.png", "08_model.png")
    assert f"{len(pictures)} pictures in {folder / 'trace'}/" in out
    next_steps = out.split("\nNext steps\n")[1]
    assert "make serve, then open http://127.0.0.1:8000" in next_steps
    assert "http://127.0.0.1:8000/manual" in next_steps
    assert f"recognise {folder / 'scan.mcap'}\n" in next_steps
    check_shown_output(out.replace(f"{tmp_path}/", ""))
    (folder / "mine.txt").write_text("keep")
    assert main(["demo", str(folder)]) == 1
    assert (folder / "mine.txt").exists()


def check_shown_output(out: str) -> None:
    """Check that the output of the demo that the README shows has the same lines, in the same order.

    The figures and the findings depend on the noise of the exposures, which no seed fixes, so that other grasps may be
    the best. The lines of progress are shortened in the README.
    """
    shown = shown_after("README.md", "make demo")
    assert out.startswith(shown.partition("  (and so on")[0])
    assert labels_of_demo(out) == labels_of_demo(shown)
    for label in ("Live scan", "Chain 0", "Verdict", "Against the truth"):
        assert differences(line_of_demo(shown, label), line_of_demo(out, label), LOOSE) == []


def line_of_demo(out: str, label: str) -> str:
    """Return the line of the demo's result with a label."""
    (line,) = re.findall(rf"^{label} .*$", out, re.MULTILINE)
    return line


def labels_of_demo(out: str) -> list[str]:
    """Return the labels of the lines of the demo's result, without those of findings."""
    labels = [line[:19].strip() for line in out[out.index("Live scan ") :].splitlines()]
    return [label for label in labels if label not in ("Note", "Doubt", "Blocking")]


def check_best_grasp(out: str, model: dict[str, Any]) -> None:
    """Check that the printed joint angles put the flange where the printed grasp of the model needs it."""
    number, chain = map(int, re.findall(r"^Best grasp +grasp (\d+): chain (\d+) at \d+ mm, ", out, re.MULTILINE)[0])
    grasp = model["grasps"][number]
    assert chain == grasp["chain"]
    lines = {line[:19].strip(): line[19:] for line in out.splitlines()}
    assert lines["Best grasp"].endswith(f"open to {grasp['opening_m'] * 1000:.1f} mm")
    flange = grasp["T_base_flange"]
    shown = [array(text) for text in re.findall(r"\[.*?\]", lines["Flange at"])]
    assert len(shown) == 3
    for name, position_mm in zip(("pregrasp", "grasp", "retreat"), shown, strict=True):
        np.testing.assert_allclose(position_mm / 1000, np.array(flange[name])[:3, 3], rtol=0, atol=1e-4)
    for label, name in (("Joints, pre-grasp", "pregrasp"), ("Joints, grasp", "grasp")):
        found, wanted = forward("ur5e", array(lines[label])), np.array(flange[name])
        # four digits of six angles are up to 0.3 mm at a reach of 0.9 m
        np.testing.assert_allclose(found[:3, 3], wanted[:3, 3], rtol=0, atol=3e-4)
        half_turn = np.diag((-1.0, -1.0, 1.0))
        off = [np.abs(found[:3, :3] - wanted[:3, :3] @ turn).max() for turn in (np.eye(3), half_turn)]
        assert min(off) < 3e-4, "the gripper may be turned by pi about its approach"


def array(text: str) -> NDArray[np.float64]:
    """Return the numbers of a printed list."""
    return np.array(json.loads(text.removesuffix(" rad")))


def test_demo_says_why_no_grasp_is_reached(recording_file: Path) -> None:
    """A gripper of 100 mm is so short that the camera meets the table."""
    settings = CellSettings(gripper=GripperSettings(length_m=0.1))
    recording, gripper = read_recording(recording_file), settings.gripper.to_gripper()
    scene = Scene(workspace_m=recording.header.workspace_m)
    grasps = recognise(recording.views, RecognitionRequest(radius_m=0.0042, gripper=gripper), scene).model.grasps
    # the string of this recording lies around the origin, where the base of the arm would be
    T_workspace = from_rotation_vector((0.4, 0.0, 0.0), (0.0, 0.0, 0.0))
    moved = [replace(grasp, T_base_grasp=T_workspace @ grasp.T_base_grasp) for grasp in grasps]
    hand_eye = simulated_world(settings).nominal_hand_eye
    (line,) = describe_best_grasp(ReachFinder(settings).find("demo", moved, gripper, hand_eye, None))
    assert line.startswith("Best grasp         none that the arm can reach: the camera")
    counts = [tuple(map(int, found)) for found in re.findall(r"\((\d+) of (\d+)\)", line)]
    assert sum(count for count, _ in counts) == len(grasps) > 50
    assert {total for _, total in counts} == {len(grasps)}
    assert describe_best_grasp([]) == ["Best grasp         none: the model has no grasps"]


def test_demo_reports_why_the_scan_failed(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def fail(*_: object) -> None:
        raise TaskFailedError("recognition-timeout", "recognition was stopped at its time limit")

    monkeypatch.setattr("service.cli.commands.demo.take_scan", fail)
    assert main(["demo", str(tmp_path / "demo")]) == 1
    out, err = capsys.readouterr()
    assert out == ""
    assert "the scan failed: recognition was stopped at its time limit; try again" in err


def test_indented_json_has_the_same_value() -> None:
    value = {"a": [], "b": {}, "c": [1, None, "x, y"], "d": [[1.5, 2], {"e": [True]}, []], "f": ({"g": 0},)}
    text = indented(value)
    assert json.loads(text) == json.loads(json.dumps(value))
    assert '"c": [1, null, "x, y"],\n' in text
    assert "    [1.5, 2],\n" in text
    with pytest.raises(ValueError, match="not JSON compliant"):
        indented([float("nan")])


def test_openapi_prints_the_description(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["openapi"]) == 0
    assert capsys.readouterr().out == openapi_document()


def test_recognise_uses_the_gripper_of_the_configuration(
    capsys: pytest.CaptureFixture[str], recording_file: Path, tmp_path: Path
) -> None:
    config = tmp_path / "cell.toml"
    config.write_text("[gripper]\nstroke_m = 0.008\n")
    code, (model,), _ = run(capsys, "recognise", recording_file, "--config", config)
    assert (code, model["grasps"]) == (0, [])
    (note,) = [found for found in model["quality"]["findings"] if found["code"] == "no-grasp"]
    assert "the gripper opens 8.0 mm" in note["message"]

    config.write_text("[gripper]\nstroke_m = 8.0\n")
    code, documents, err = run(capsys, "recognise", recording_file, "--config", config)
    assert (code, documents) == (1, [])
    assert "metres, not mm" in err


@pytest.mark.parametrize(
    "arguments",
    [
        [],
        ["recognise"],
        ["unknown"],
        ["recognise", "x", "--method", "guess"],
        ["simulate", "x.mcap", "--camera", "kinect"],
        ["bench", "--camera", "kinect"],
    ],
)
def test_wrong_arguments_exit_with_2(arguments: list[str]) -> None:
    with pytest.raises(SystemExit) as raised:
        main(arguments)
    assert raised.value.code == 2


def test_bench_of_a_wheel_asks_for_a_checkout(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "service.benchmark", None)  # as if the package were not installed
    assert main(["bench", "--only", "speed"]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err == (
        "pointchain bench: the benchmark is not part of the installed package, because it is only for development; "
        "run `pointchain bench` in a checkout of the sources\n"
    )


def test_serve_reports_why_it_cannot_start(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    folder = DataFolder(tmp_path / "data")
    try:
        assert main(["serve", "--unsupervised", "--data-dir", str(tmp_path / "data")]) == 1
        assert "another service uses this data folder" in capsys.readouterr().err
    finally:
        folder.close()
    with socket.create_server(("127.0.0.1", 0)) as occupied:
        port = occupied.getsockname()[1]
        assert main(["serve", "--unsupervised", "--data-dir", str(tmp_path / "data"), "--port", str(port)]) == 1
    err = capsys.readouterr().err
    assert f"cannot listen on 127.0.0.1:{port}: " in err
    assert "--port" in err
    config = tmp_path / "cell.toml"
    config.write_text("prot = 8000\n")
    assert main(["serve", "--unsupervised", "--config", str(config)]) == 1
    assert "prot" in capsys.readouterr().err
