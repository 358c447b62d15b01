"""`--cluster`: a scheduler and workers of somebody else's, here of this test."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from distributed import LocalCluster

from service.batch import cluster as archive_cluster
from service.batch import recognise_file
from service.cli.main import main

pytestmark = pytest.mark.xdist_group("cell")  # one at a time: each is several busy processes


@pytest.fixture(scope="module")
def address() -> Iterator[str]:
    """Of a cluster with one worker."""
    cluster = LocalCluster(n_workers=1, threads_per_worker=1, host="127.0.0.1", dashboard_address=":0")
    with cluster:
        yield cluster.scheduler_address


def test_it_recognises_there_and_names_files_as_they_were_asked_for(
    address: str, recording_file: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.chdir(recording_file.parent)
    files = [recording_file.name, "missing.mcap", recording_file.name]
    assert main(["recognise", "--cluster", address, *files]) == 1
    documents = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [document["recording"]["file"] for document in documents] == files
    assert documents[1]["error"]["type"] == "urn:pointchain:recording-unreadable"
    assert len(documents[0]["chains"]) == 1
    assert documents[0] == documents[2]


def test_a_worker_of_another_version_is_told(
    address: str, recording_file: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(recognise_file, "version", lambda _: "99.0")
    assert main(["recognise", "--cluster", address, str(recording_file)]) == 1
    out, err = capsys.readouterr()
    assert out == ""
    assert "this is 99.0; install the same there" in err


def lacking(*_: object, **__: object) -> None:
    """As on a worker without the package."""
    raise ModuleNotFoundError("No module named 'service'")


def test_a_worker_without_the_package_is_told(
    address: str, recording_file: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(archive_cluster, "work_on", lacking)
    assert main(["recognise", "--cluster", address, str(recording_file)]) == 1
    assert "No module named 'service'): install the same release there" in capsys.readouterr().err


def test_no_scheduler_is_told(
    recording_file: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(archive_cluster, "SCHEDULER_S", 1.0)
    assert main(["recognise", "--cluster", "tcp://127.0.0.1:9", str(recording_file)]) == 1
    assert "no Dask scheduler answers at tcp://127.0.0.1:9" in capsys.readouterr().err


def test_no_worker_is_told(recording_file: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(archive_cluster, "WORKERS_S", 1.0)
    cluster = LocalCluster(n_workers=0, host="127.0.0.1", dashboard_address=":0")
    with cluster:
        assert main(["recognise", "--cluster", cluster.scheduler_address, str(recording_file)]) == 1
    assert "has no worker" in capsys.readouterr().err


@pytest.mark.parametrize("error", [RuntimeError("odd"), BaseException("a panic of native code")])
def test_whatever_goes_wrong_with_one_costs_only_itself(
    error: BaseException,
    address: str,
    recording_file: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
):
    real = recognise_file.recognise_recording

    def recognise_recording(path: Path, *more: Any) -> Any:
        if path.name == "odd.mcap":
            raise error
        return real(path, *more)

    monkeypatch.setattr(recognise_file, "recognise_recording", recognise_recording)
    assert main(["recognise", "odd.mcap", str(recording_file)]) == 1
    first, second = (json.loads(line) for line in capsys.readouterr().out.splitlines())
    assert first["error"]["type"] == "urn:pointchain:internal"
    assert len(second["chains"]) == 1
    # On a cluster too, where what a worker raises may be anything.
    monkeypatch.setattr(archive_cluster, "work_on", unfit)
    assert main(["recognise", "--cluster", address, str(recording_file), "other.mcap"]) == 1
    first, second = (json.loads(line) for line in capsys.readouterr().out.splitlines())
    assert "unfit" in first["error"]["detail"]
    assert second["error"]["type"] == "urn:pointchain:internal"


def unfit(*_: object, **__: object) -> None:
    """As a worker that cannot give back what it made."""
    raise ValueError("unfit")


@pytest.mark.soak  # each worker needs seconds to start
def test_a_recording_that_ends_every_worker_costs_only_itself(
    recording_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    killer = tmp_path / "killer.mcap"
    killer.write_bytes(recording_file.read_bytes())
    # A worker is given the next ones as well, which its death takes with it.
    others = [tmp_path / f"{k}.mcap" for k in range(3)]
    for other in others:
        other.write_bytes(recording_file.read_bytes())
    out = tmp_path / "lines.jsonl"
    # Inherited by the workers: what would be a fault of native code.
    (tmp_path / "sitecustomize.py").write_text(
        "import os, cell.recording as r\n"
        "real = r.read_recording\n"
        "r.read_recording = lambda path: os._exit(11) if path.name == 'killer.mcap' else real(path)\n"
    )
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=":")
    assert main(["recognise", "--jobs", "1", "--out", str(out), str(killer), *map(str, others)]) == 1
    killed, *rest = (json.loads(line) for line in out.read_text().splitlines())
    assert killed["error"]["type"] == "urn:pointchain:recognition-crashed"
    assert [len(document["chains"]) for document in rest] == [1, 1, 1]
