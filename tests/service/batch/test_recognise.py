"""`pointchain recognise` over many recordings: several processes, an output file, and continued runs."""

import dataclasses
import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import psutil
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from calibration.geometry.transforms import from_rotation_vector
from cell.simulation.offline_scan import simulate, write_simulation
from cell.simulation.rendering.depth_camera import camera_model
from cell.simulation.scenes.scenes import make_scene
from service.batch import recognise as recognise_module
from service.cli.main import main

pytestmark = pytest.mark.xdist_group("service")  # one at a time, because some tests run several busy processes

RECORDINGS = 6
POINTCHAIN = (sys.executable, "-c", "import sys; from service.cli.main import main; sys.exit(main())", "recognise")


@pytest.fixture(scope="module")
def batch(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with recordings of different scenes, one of them in a subfolder, and a damaged one."""
    folder = tmp_path_factory.mktemp("batch")
    (folder / "deeper").mkdir()
    for seed in range(RECORDINGS):
        scan = simulate(make_scene("random", seed), camera_model("exact", (320, 200)), seed, views=4)
        write_simulation(scan, folder / ("deeper" if seed == 0 else "") / f"random-{seed}.mcap")
    whole = (folder / "random-1.mcap").read_bytes()
    (folder / "damaged.mcap").write_bytes(whole[: len(whole) // 20])
    return folder


@pytest.fixture(scope="module")
def one_by_one(batch: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the output of a run in this process alone."""
    out = tmp_path_factory.mktemp("out") / "one.jsonl"
    assert main(["recognise", str(batch), "--out", str(out)]) == 1, "one recording is damaged"
    return out


def figures(lines: str) -> list[dict[str, Any]]:
    """Return the documents without their times."""
    documents = [json.loads(line) for line in lines.splitlines()]
    for document in documents:
        document.pop("timing_s", None)
    return documents


def count_recognised(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Return a list that collects the files recognised from now on."""
    recognised: list[str] = []
    real = recognise_module.recognise_file

    def recognise_file(file: str, *args: Any) -> Any:
        recognised.append(Path(file).name)
        return real(file, *args)

    monkeypatch.setattr(recognise_module, "recognise_file", recognise_file)
    return recognised


def test_a_folder_stands_for_its_recordings_in_order(batch: Path, one_by_one: Path):
    documents = figures(one_by_one.read_text())
    assert [document["recording"]["file"] for document in documents] == [str(p) for p in sorted(batch.rglob("*.mcap"))]
    damaged = next(document for document in documents if "damaged" in document["recording"]["file"])
    assert damaged["error"]["type"] == "urn:pointchain:recording-empty"
    assert sum("chains" in document for document in documents) == RECORDINGS
    assert not one_by_one.with_name("one.jsonl.part").exists()


def test_a_folder_without_recordings_is_an_error(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    assert main(["recognise", str(tmp_path)]) == 1
    assert "has no recordings" in capsys.readouterr().err


def test_parquet_has_the_same_documents(batch: Path, one_by_one: Path, tmp_path: Path):
    out = tmp_path / "lines.parquet"
    assert main(["recognise", str(batch), "--out", str(out)]) == 1
    table = pq.read_table(out)
    wanted = figures(one_by_one.read_text())
    assert figures("\n".join(table["document"].to_pylist())) == wanted
    models = [document for document in wanted if "chains" in document]
    assert [count for count in table["crossings"].to_pylist() if count is not None] == [
        len(model["crossings"]) for model in models
    ]
    assert [error for error in table["error"].to_pylist() if error] == ["recording-empty"]


def test_parquet_has_the_verdict_and_the_codes_of_the_findings(recording_file: Path, tmp_path: Path):
    """With 6 mm as radius of the string of 4.2 mm, the models have a doubt. A cut recording also has a note."""
    whole = recording_file.read_bytes()
    files = [tmp_path / name for name in ("cut.mcap", "whole.mcap", "damaged.mcap")]
    for file, content in zip(files, (whole[: len(whole) * 3 // 4], whole, whole[: len(whole) // 20]), strict=True):
        file.write_bytes(content)
    out = tmp_path / "lines.parquet"
    assert main(["recognise", *map(str, files), "--radius", "0.006", "--out", str(out)]) == 1
    cut, complete, damaged = pq.read_table(out, columns=["verdict", "doubts", "notes"]).to_pylist()
    assert (cut["verdict"], cut["notes"]) == ("review", ["no-trusted-grasp", "recording-incomplete"])
    assert "radius-much-smaller" in cut["doubts"]
    assert complete == {
        "verdict": "review",
        "doubts": ["radius-much-smaller", "table-not-covered"],
        "notes": ["no-trusted-grasp"],
    }
    assert damaged == {"verdict": None, "doubts": None, "notes": None}


def test_only_new_changed_and_unreadable_recordings_are_recognised_again(
    batch: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    out, folder = tmp_path / "lines.jsonl", tmp_path / "recordings"
    folder.mkdir()
    for seed in (1, 2, 3):
        (folder / f"{seed}.mcap").write_bytes((batch / f"random-{seed}.mcap").read_bytes())
    (folder / "damaged.mcap").write_bytes((batch / "damaged.mcap").read_bytes())
    files = [*map(str, sorted(folder.iterdir())), str(folder / "late.mcap")]
    command = ["recognise", *files, "--out", str(out)]
    assert main(command) == 1
    first = figures(out.read_text())
    assert first[-1]["error"]["type"] == "urn:pointchain:recording-unreadable", "late.mcap does not exist yet"

    recognised = count_recognised(monkeypatch)
    (folder / "late.mcap").write_bytes((batch / "random-4.mcap").read_bytes())
    (folder / "2.mcap").write_bytes((batch / "random-5.mcap").read_bytes())
    (folder / "3.mcap").unlink()
    assert main(command) == 1
    assert recognised == ["2.mcap", "late.mcap"]
    second = figures(out.read_text())
    assert [document["recording"]["file"] for document in second] == files
    assert second[2] == first[2], "the model of a deleted recording is kept"
    assert second[1]["chains"] != first[1]["chains"]
    assert "chains" in second[-1]


def test_a_renamed_recording_is_not_recognised_again(
    batch: Path, one_by_one: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    out, folder = tmp_path / "lines.parquet", tmp_path / "recordings"
    folder.mkdir()
    for seed in (1, 2):
        (folder / f"{seed}.mcap").write_bytes((batch / f"random-{seed}.mcap").read_bytes())
    monkeypatch.chdir(tmp_path)
    assert main(["recognise", "recordings", "--out", str(out)]) == 0
    first = pq.read_table(out).to_pylist()

    recognised = count_recognised(monkeypatch)
    assert main(["recognise", str(folder), "--out", str(out)]) == 0, "the same folder by another path"
    folder.rename(tmp_path / "moved")
    (tmp_path / "moved" / "copy.mcap").write_bytes((tmp_path / "moved" / "1.mcap").read_bytes())
    assert main(["recognise", "moved", "--out", str(out)]) == 0
    assert recognised == []
    last = pq.read_table(out).to_pylist()
    assert [row["file"] for row in last] == ["moved/1.mcap", "moved/2.mcap", "moved/copy.mcap"]
    assert [json.loads(row["document"])["recording"]["file"] for row in last] == [row["file"] for row in last]
    assert [row["length_m"] for row in last] == [first[k]["length_m"] for k in (0, 1, 0)]

    one, two, kept = (tmp_path / "moved" / f"{name}.mcap" for name in (1, 2, "copy"))
    kept.unlink()
    for old, new in ((one, kept), (two, one), (kept, two)):
        old.rename(new)
    assert main(["recognise", "moved", "--out", str(out)]) == 0
    assert recognised == []
    last = pq.read_table(out).to_pylist()
    assert [row["sha256"] for row in last[-2:]] == [first[1]["sha256"], first[0]["sha256"]], "the two were exchanged"
    assert [row["length_m"] for row in last[-2:]] == [first[1]["length_m"], first[0]["length_m"]]


def test_a_file_name_that_is_not_valid_text_has_a_row(batch: Path, tmp_path: Path):
    odd = tmp_path / os.fsdecode(b"caf\xe9.mcap")
    odd.write_bytes((batch / "damaged.mcap").read_bytes())
    out = tmp_path / "lines.parquet"
    assert main(["recognise", str(odd), "--out", str(out)]) == 1
    (row,) = pq.read_table(out).to_pylist()
    assert row["file"].endswith("caf\\udce9.mcap")
    assert row["error"] == "recording-empty"


def test_linked_folders_are_searched_once(batch: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    (tmp_path / "damaged").mkdir()
    (tmp_path / "damaged" / "one.mcap").write_bytes((batch / "damaged.mcap").read_bytes())
    folder = tmp_path / "folder"
    folder.mkdir()
    (folder / "linked").symlink_to(tmp_path / "damaged")
    (folder / "loop").symlink_to(folder)
    assert main(["recognise", str(folder)]) == 1
    (line,) = capsys.readouterr().out.splitlines()
    assert json.loads(line)["recording"]["file"] == str(folder / "linked" / "one.mcap")


def test_a_failed_picture_keeps_the_model_and_pictures_are_not_overwritten(
    batch: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "scan.mcap").write_bytes((batch / "random-1.mcap").read_bytes())
    trace = ["--trace", str(tmp_path / "pictures")]
    assert main(["recognise", str(tmp_path / "a"), str(tmp_path / "b"), *trace]) == 1
    assert "2 recordings are called scan" in capsys.readouterr().err
    (tmp_path / "a" / "scan.truth.json").write_text("{")
    assert main(["recognise", str(tmp_path / "a"), *trace]) == 0
    out, err = capsys.readouterr()
    assert "chains" in json.loads(out)
    assert "no pictures were written: JSONDecodeError" in err


def test_a_killed_run_is_continued(batch: Path, one_by_one: Path, tmp_path: Path):
    out = tmp_path / "lines.jsonl"
    part = tmp_path / "lines.jsonl.part"
    command = [*POINTCHAIN, str(batch), "--out", str(out)]
    with subprocess.Popen(command, stderr=subprocess.DEVNULL) as process:
        wait_until(lambda: part.exists() and part.read_bytes().count(b"\n") >= 2)
        process.kill()
    assert not out.exists()
    done = part.read_bytes().count(b"\n")
    with part.open("ab") as file:
        file.write(b'{"schema": "pointchain/2", "chai')  # a line that a kill cut off
    again = subprocess.run(command, capture_output=True, text=True, check=False)
    assert again.returncode == 1
    assert f"{done} were done before" in again.stderr
    assert figures(out.read_text()) == figures(one_by_one.read_text())
    assert not part.exists()


def test_ctrl_c_ends_all_processes_quietly_and_keeps_the_lines(batch: Path, tmp_path: Path):
    part = tmp_path / "lines.jsonl.part"
    many = tmp_path / "many"  # too many to finish before the test notices the first line
    many.mkdir()
    for number in range(60):
        (many / f"{number}.mcap").hardlink_to(batch / "random-1.mcap")
    command = [*POINTCHAIN, str(many), "--jobs", "2", "--out", str(tmp_path / "lines.jsonl")]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True, start_new_session=True) as process:
        wait_until(lambda: part.exists() and part.read_bytes().count(b"\n") >= 1)
        workers = psutil.Process(process.pid).children(recursive=True)
        os.killpg(process.pid, signal.SIGINT)  # a terminal also sends it to the workers
        err = process.communicate(timeout=60)[1]
    assert process.returncode == 130
    *messages, last = err.splitlines()
    assert last == "stopped"
    about_models = re.compile(rf"pointchain recognise: {many}/\d+\.mcap: (verdict: review|doubt: .* \[[a-z-]+\])")
    assert [message for message in messages if not about_models.fullmatch(message)] == []
    assert len(workers) >= 2
    assert not psutil.wait_procs(workers, timeout=20)[1], "a worker still runs"
    assert part.read_bytes().count(b"\n") >= 1


def test_several_processes_print_the_same_lines_in_order_even_if_one_is_killed(batch: Path, one_by_one: Path):
    command = [*POINTCHAIN, str(batch), "--jobs", "2"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        first = process.stdout.readline()
        workers = [
            child
            for child in psutil.Process(process.pid).children(recursive=True)
            if any("spawn_main" in word for word in child.cmdline())
        ]
        assert len(workers) == 2
        workers[0].kill()
        rest, err = process.communicate(timeout=120)
    assert process.returncode == 1
    assert figures(first + rest) == figures(one_by_one.read_text())
    assert "damaged.mcap" in err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--method", "enhanced"], "method graph, now enhanced"),
        (["--radius", "0.004"], "radius_m None, now 0.004"),
        (["--radius", "nan"], "radius_m None, now nan"),
    ],
)
def test_a_file_of_other_settings_is_rejected_and_unchanged(
    batch: Path, one_by_one: Path, arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]
):
    before = one_by_one.read_bytes()
    assert main(["recognise", str(batch), "--out", str(one_by_one), *arguments]) == 1
    err = capsys.readouterr().err
    assert message in err
    assert "name another file" in err
    assert one_by_one.read_bytes() == before
    assert not one_by_one.with_name("one.jsonl.part").exists()


@pytest.mark.parametrize("suffix", [".jsonl", ".parquet", ".jsonl.part"])
def test_a_file_of_another_schema_is_rejected_and_unchanged(
    batch: Path, one_by_one: Path, tmp_path: Path, suffix: str, capsys: pytest.CaptureFixture[str]
):
    """Check that the lines of another version do not get into the output of this one."""
    old = [json.loads(line) | {"schema": "pointchain/1"} for line in one_by_one.read_text().splitlines()]
    file = tmp_path / f"lines{suffix}"
    if suffix == ".parquet":
        pq.write_table(pa.table({"document": [json.dumps(line) for line in old]}), file)
    else:
        file.write_text("".join(f"{json.dumps(line)}\n" for line in old))
    before = file.read_bytes()
    out = tmp_path / f"lines{suffix}".removesuffix(".part")
    assert main(["recognise", str(batch), "--out", str(out)]) == 1
    assert "has models of schema pointchain/1, now pointchain/2: name another file" in capsys.readouterr().err
    assert file.read_bytes() == before


def test_a_file_of_another_kind_is_rejected_and_unchanged(
    batch: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):
    recognised = count_recognised(monkeypatch)
    out = tmp_path / "notes.jsonl"
    out.write_text('{"dear": "diary"}\n')
    assert main(["recognise", str(batch), "--out", str(out)]) == 1
    assert "is not the output of pointchain recognise" in capsys.readouterr().err
    assert out.read_text() == '{"dear": "diary"}\n'
    assert not recognised


def test_an_unwritable_output_file_is_reported_before_any_work(
    batch: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):
    recognised = count_recognised(monkeypatch)
    assert main(["recognise", str(batch), "--out", str(tmp_path / "nowhere" / "lines.jsonl")]) == 1
    assert "cannot be written: No such file or directory" in capsys.readouterr().err
    with pytest.raises(SystemExit) as exit_info:
        main(["recognise", str(batch), "--out", str(tmp_path / "lines.csv")])
    assert exit_info.value.code == 2
    assert not recognised


def wait_until(condition: Callable[[], bool]) -> None:
    deadline_s = time.monotonic() + 60.0
    while not condition():
        assert time.monotonic() < deadline_s, "timeout"
        time.sleep(0.01)


def test_an_unused_view_is_reported_with_its_reason(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scan = simulate(make_scene("loop", 2), camera_model("exact", (320, 200)), 2, views=6)
    moved = from_rotation_vector((0.03, 0.0, 0.0), (0.0, 0.0, 0.0))
    views = [
        dataclasses.replace(view, T_base_flange=moved @ view.T_base_flange) if view.index == 3 else view
        for view in scan.views
    ]
    write_simulation(dataclasses.replace(scan, views=tuple(views)), tmp_path / "scan.mcap")
    assert main(["recognise", str(tmp_path / "scan.mcap")]) == 0
    printed = capsys.readouterr()
    quality = json.loads(printed.out)["quality"]
    unused = [(view["index"], view["code"]) for view in quality["views"] if not view["used"]]
    assert unused == [(3, "view-contradicting")]
    (doubt,) = [found for found in quality["findings"] if found["severity"] == "doubt"]
    assert printed.err.splitlines() == [
        f"pointchain recognise: {tmp_path / 'scan.mcap'}: {message}"
        for message in (
            "verdict: review",
            f"doubt: {doubt['message']} [table-not-covered]",
            f"view 3 was excluded: {quality['views'][3]['reason']}",
        )
    ]
