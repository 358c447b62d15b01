"""`pointchain recognise` over many recordings: by several processes, into a file, gone on with after it was ended."""

import dataclasses
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import psutil
import pyarrow.parquet as pq
import pytest

from calibration.geometry.transforms import from_rotation_vector
from cell.simulation.offline_scan import simulate, write_simulation
from cell.simulation.rendering.depth_camera import camera_model
from cell.simulation.scenes.scenes import make_scene
from service.batch import recognise as archive_recognise
from service.cli.main import main

pytestmark = pytest.mark.xdist_group("cell")  # one at a time: some are several busy processes

RECORDINGS = 6
POINTCHAIN = (sys.executable, "-c", "import sys; from service.cli.main import main; sys.exit(main())", "recognise")


@pytest.fixture(scope="module")
def archive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with recordings of other scenes, one in a folder of its own, and one that is damaged."""
    folder = tmp_path_factory.mktemp("archive")
    (folder / "deeper").mkdir()
    for seed in range(RECORDINGS):
        scan = simulate(make_scene("random", seed), camera_model("ideal", (320, 200)), seed, views=4)
        write_simulation(scan, folder / ("deeper" if seed == 0 else "") / f"random-{seed}.mcap")
    whole = (folder / "random-1.mcap").read_bytes()
    (folder / "damaged.mcap").write_bytes(whole[: len(whole) // 20])
    return folder


@pytest.fixture(scope="module")
def one_by_one(archive: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What this process alone makes of it."""
    out = tmp_path_factory.mktemp("out") / "one.jsonl"
    assert main(["recognise", str(archive), "--out", str(out)]) == 1, "one recording is damaged"
    return out


def figures(lines: str) -> list[dict[str, Any]]:
    """The documents, without how long it took."""
    documents = [json.loads(line) for line in lines.splitlines()]
    for document in documents:
        document.pop("timing_s", None)
    return documents


def counting(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The files that are recognised from now on."""
    begun: list[str] = []
    real = archive_recognise.recognise_file

    def recognise_file(file: str, *args: Any) -> Any:
        begun.append(Path(file).name)
        return real(file, *args)

    monkeypatch.setattr(archive_recognise, "recognise_file", recognise_file)
    return begun


def test_a_folder_stands_for_its_recordings_in_order(archive: Path, one_by_one: Path):
    documents = figures(one_by_one.read_text())
    assert [document["recording"]["file"] for document in documents] == [
        str(p) for p in sorted(archive.rglob("*.mcap"))
    ]
    damaged = next(document for document in documents if "damaged" in document["recording"]["file"])
    assert damaged["error"]["type"] == "urn:pointchain:recording-empty"
    assert sum("chains" in document for document in documents) == RECORDINGS
    assert not one_by_one.with_name("one.jsonl.part").exists()


def test_a_folder_without_recordings_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    assert main(["recognise", str(tmp_path)]) == 1
    assert "has no recordings" in capsys.readouterr().err


def test_parquet_has_the_same_documents(archive: Path, one_by_one: Path, tmp_path: Path):
    out = tmp_path / "lines.parquet"
    assert main(["recognise", str(archive), "--out", str(out)]) == 1
    table = pq.read_table(out)
    wanted = figures(one_by_one.read_text())
    assert figures("\n".join(table["document"].to_pylist())) == wanted
    models = [document for document in wanted if "chains" in document]
    assert [count for count in table["crossings"].to_pylist() if count is not None] == [
        len(model["crossings"]) for model in models
    ]
    assert [error for error in table["error"].to_pylist() if error] == ["recording-empty"]


def test_only_what_is_new_changed_or_worth_another_trial_is_recognised_again(
    archive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    out, folder = tmp_path / "lines.jsonl", tmp_path / "recordings"
    folder.mkdir()
    for seed in (1, 2, 3):
        (folder / f"{seed}.mcap").write_bytes((archive / f"random-{seed}.mcap").read_bytes())
    (folder / "damaged.mcap").write_bytes((archive / "damaged.mcap").read_bytes())
    files = [*map(str, sorted(folder.iterdir())), str(folder / "late.mcap")]
    command = ["recognise", *files, "--out", str(out)]
    assert main(command) == 1
    first = figures(out.read_text())
    assert first[-1]["error"]["type"] == "urn:pointchain:recording-unreadable", "late.mcap is not there yet"

    begun = counting(monkeypatch)
    (folder / "late.mcap").write_bytes((archive / "random-4.mcap").read_bytes())
    (folder / "2.mcap").write_bytes((archive / "random-5.mcap").read_bytes())
    (folder / "3.mcap").unlink()
    assert main(command) == 1
    assert begun == ["2.mcap", "late.mcap"]
    second = figures(out.read_text())
    assert [document["recording"]["file"] for document in second] == files
    assert second[2] == first[2], "of a recording that is gone the model stays"
    assert second[1]["chains"] != first[1]["chains"]
    assert "chains" in second[-1]


def test_what_was_done_under_another_name_is_not_done_again(
    archive: Path, one_by_one: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    out, folder = tmp_path / "lines.parquet", tmp_path / "recordings"
    folder.mkdir()
    for seed in (1, 2):
        (folder / f"{seed}.mcap").write_bytes((archive / f"random-{seed}.mcap").read_bytes())
    monkeypatch.chdir(tmp_path)
    assert main(["recognise", "recordings", "--out", str(out)]) == 0
    first = pq.read_table(out).to_pylist()

    begun = counting(monkeypatch)
    assert main(["recognise", str(folder), "--out", str(out)]) == 0, "the same, told otherwise"
    folder.rename(tmp_path / "moved")
    (tmp_path / "moved" / "copy.mcap").write_bytes((tmp_path / "moved" / "1.mcap").read_bytes())
    assert main(["recognise", "moved", "--out", str(out)]) == 0
    assert begun == []
    last = pq.read_table(out).to_pylist()
    assert [row["file"] for row in last] == ["moved/1.mcap", "moved/2.mcap", "moved/copy.mcap"]
    assert [json.loads(row["document"])["recording"]["file"] for row in last] == [row["file"] for row in last]
    assert [row["length_m"] for row in last] == [first[k]["length_m"] for k in (0, 1, 0)]

    one, two, kept = (tmp_path / "moved" / f"{name}.mcap" for name in (1, 2, "copy"))
    kept.unlink()
    for old, new in ((one, kept), (two, one), (kept, two)):
        old.rename(new)
    assert main(["recognise", "moved", "--out", str(out)]) == 0
    assert begun == []
    last = pq.read_table(out).to_pylist()
    assert [row["sha256"] for row in last[-2:]] == [first[1]["sha256"], first[0]["sha256"]], "they have changed places"
    assert [row["length_m"] for row in last[-2:]] == [first[1]["length_m"], first[0]["length_m"]]


def test_a_name_that_is_no_text_has_its_row(archive: Path, tmp_path: Path):
    odd = tmp_path / os.fsdecode(b"caf\xe9.mcap")
    odd.write_bytes((archive / "damaged.mcap").read_bytes())
    out = tmp_path / "lines.parquet"
    assert main(["recognise", str(odd), "--out", str(out)]) == 1
    (row,) = pq.read_table(out).to_pylist()
    assert row["file"].endswith("caf\\udce9.mcap")
    assert row["error"] == "recording-empty"


def test_linked_folders_are_looked_into_once(archive: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    (tmp_path / "damaged").mkdir()
    (tmp_path / "damaged" / "one.mcap").write_bytes((archive / "damaged.mcap").read_bytes())
    asked = tmp_path / "asked"
    asked.mkdir()
    (asked / "linked").symlink_to(tmp_path / "damaged")
    (asked / "round").symlink_to(asked)
    assert main(["recognise", str(asked)]) == 1
    (line,) = capsys.readouterr().out.splitlines()
    assert json.loads(line)["recording"]["file"] == str(asked / "linked" / "one.mcap")


def test_pictures_cost_no_model_and_overwrite_none(archive: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "scan.mcap").write_bytes((archive / "random-1.mcap").read_bytes())
    trace = ["--trace", str(tmp_path / "pictures")]
    assert main(["recognise", str(tmp_path / "a"), str(tmp_path / "b"), *trace]) == 1
    assert "2 recordings are called scan" in capsys.readouterr().err
    (tmp_path / "a" / "scan.truth.json").write_text("{")
    assert main(["recognise", str(tmp_path / "a"), *trace]) == 0
    out, err = capsys.readouterr()
    assert "chains" in json.loads(out)
    assert "no pictures: JSONDecodeError" in err


def test_a_run_that_was_killed_is_gone_on_with(archive: Path, one_by_one: Path, tmp_path: Path):
    out = tmp_path / "lines.jsonl"
    part = tmp_path / "lines.jsonl.part"
    command = [*POINTCHAIN, str(archive), "--out", str(out)]
    with subprocess.Popen(command, stderr=subprocess.DEVNULL) as process:
        wait(lambda: part.exists() and part.read_bytes().count(b"\n") >= 2)
        process.kill()
    assert not out.exists()
    done = part.read_bytes().count(b"\n")
    with part.open("ab") as file:
        file.write(b'{"schema": "pointchain/1", "chai')  # as a kill in the middle of a line leaves it
    again = subprocess.run(command, capture_output=True, text=True, check=False)
    assert again.returncode == 1
    assert f"{done} had their line already" in again.stderr
    assert figures(out.read_text()) == figures(one_by_one.read_text())
    assert not part.exists()


def test_ctrl_c_ends_all_processes_quietly_and_keeps_the_lines(archive: Path, tmp_path: Path):
    part = tmp_path / "lines.jsonl.part"
    many = tmp_path / "many"  # more than can be done before anybody notices that one is
    many.mkdir()
    for number in range(60):
        (many / f"{number}.mcap").hardlink_to(archive / "random-1.mcap")
    command = [*POINTCHAIN, str(many), "--jobs", "2", "--out", str(tmp_path / "lines.jsonl")]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True, start_new_session=True) as process:
        wait(lambda: part.exists() and part.read_bytes().count(b"\n") >= 1)
        workers = psutil.Process(process.pid).children(recursive=True)
        os.killpg(process.pid, signal.SIGINT)  # as a terminal does: the workers get it too
        err = process.communicate(timeout=60)[1]
    assert process.returncode == 130
    assert err.splitlines() == ["stopped"]
    assert len(workers) >= 2
    assert not psutil.wait_procs(workers, timeout=20)[1], "a process is left over"
    assert part.read_bytes().count(b"\n") >= 1


def test_several_processes_print_the_same_in_the_same_order_though_one_is_killed(archive: Path, one_by_one: Path):
    command = [*POINTCHAIN, str(archive), "--jobs", "2"]
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
    ("arguments", "said"),
    [
        (["--method", "enhanced"], "method graph, now enhanced"),
        (["--radius", "0.004"], "radius_m None, now 0.004"),
        (["--radius", "nan"], "radius_m None, now nan"),
    ],
)
def test_other_questions_do_not_go_into_the_same_file(
    archive: Path, one_by_one: Path, arguments: list[str], said: str, capsys: pytest.CaptureFixture[str]
):
    before = one_by_one.read_bytes()
    assert main(["recognise", str(archive), "--out", str(one_by_one), *arguments]) == 1
    err = capsys.readouterr().err
    assert said in err
    assert "name another file" in err
    assert one_by_one.read_bytes() == before
    assert not one_by_one.with_name("one.jsonl.part").exists()


def test_a_file_of_something_else_is_left_alone(
    archive: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):
    begun = counting(monkeypatch)
    out = tmp_path / "notes.jsonl"
    out.write_text('{"dear": "diary"}\n')
    assert main(["recognise", str(archive), "--out", str(out)]) == 1
    assert "no output of such a run" in capsys.readouterr().err
    assert out.read_text() == '{"dear": "diary"}\n'
    assert not begun


def test_where_it_cannot_be_written_is_said_before_any_work(
    archive: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):
    begun = counting(monkeypatch)
    assert main(["recognise", str(archive), "--out", str(tmp_path / "nowhere" / "lines.jsonl")]) == 1
    assert "cannot be written: No such file or directory" in capsys.readouterr().err
    with pytest.raises(SystemExit) as ended:
        main(["recognise", str(archive), "--out", str(tmp_path / "lines.csv")])
    assert ended.value.code == 2
    assert not begun


def wait(for_what: Callable[[], bool]) -> None:
    limit_s = time.monotonic() + 60.0
    while not for_what():
        assert time.monotonic() < limit_s, "it did not happen"
        time.sleep(0.01)


def test_a_view_that_is_not_used_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scan = simulate(make_scene("loop", 2), camera_model("ideal", (320, 200)), 2, views=6)
    moved = from_rotation_vector((0.03, 0.0, 0.0), (0.0, 0.0, 0.0))
    views = [
        dataclasses.replace(view, T_base_flange=moved @ view.T_base_flange) if view.index == 3 else view
        for view in scan.views
    ]
    write_simulation(dataclasses.replace(scan, views=tuple(views)), tmp_path / "scan.mcap")
    assert main(["recognise", str(tmp_path / "scan.mcap")]) == 0
    printed = capsys.readouterr()
    reasons = [view["reason"] for view in json.loads(printed.out)["quality"]["views"] if not view["used"]]
    assert len(reasons) == 1
    assert printed.err == f"pointchain recognise: {tmp_path / 'scan.mcap'}: view 3 was not used: {reasons[0]}\n"
