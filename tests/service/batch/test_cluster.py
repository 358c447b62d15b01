"""`--cluster` with a scheduler and workers that the command did not start. Here the test starts them."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from distributed import LocalCluster

from service.batch import cluster as cluster_module
from service.batch import recognise_file
from service.cli.main import main

pytestmark = pytest.mark.xdist_group("service")  # one at a time, because each test runs several busy processes


@pytest.fixture(scope="module")
def address() -> Iterator[str]:
    """Yield the address of a cluster with one worker."""
    cluster = LocalCluster(n_workers=1, threads_per_worker=1, host="127.0.0.1", dashboard_address=":0")
    with cluster:
        yield cluster.scheduler_address


def test_the_cluster_recognises_and_lines_keep_the_given_file_names(
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


def test_a_worker_of_another_version_is_an_error(
    address: str, recording_file: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(recognise_file, "version", lambda _: "99.0")
    assert main(["recognise", "--cluster", address, str(recording_file)]) == 1
    out, err = capsys.readouterr()
    assert out == ""
    assert "this is 99.0; install the same there" in err


def fail_to_import(*_: object, **__: object) -> None:
    """Fail as on a worker without the package."""
    raise ModuleNotFoundError("No module named 'service'")


def test_a_worker_without_the_package_is_an_error(
    address: str, recording_file: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(cluster_module, "recognise_on_worker", fail_to_import)
    assert main(["recognise", "--cluster", address, str(recording_file)]) == 1
    assert "No module named 'service'): install the same release there" in capsys.readouterr().err


def test_a_missing_scheduler_is_an_error(
    recording_file: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(cluster_module, "SCHEDULER_TIMEOUT_S", 1.0)
    assert main(["recognise", "--cluster", "tcp://127.0.0.1:9", str(recording_file)]) == 1
    assert "no Dask scheduler answers at tcp://127.0.0.1:9" in capsys.readouterr().err


def test_a_cluster_without_workers_is_an_error(
    recording_file: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(cluster_module, "WORKER_TIMEOUT_S", 1.0)
    cluster = LocalCluster(n_workers=0, host="127.0.0.1", dashboard_address=":0")
    with cluster:
        assert main(["recognise", "--cluster", cluster.scheduler_address, str(recording_file)]) == 1
    assert "has no worker" in capsys.readouterr().err


@pytest.mark.parametrize("error", [RuntimeError("odd"), BaseException("a panic of native code")])
def test_an_unexpected_error_affects_only_its_own_line(
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
    # the same on a cluster, where a worker may raise any exception
    monkeypatch.setattr(cluster_module, "recognise_on_worker", fail_on_worker)
    assert main(["recognise", "--cluster", address, str(recording_file), "other.mcap"]) == 1
    first, second = (json.loads(line) for line in capsys.readouterr().out.splitlines())
    assert "worker failed" in first["error"]["detail"]
    assert second["error"]["type"] == "urn:pointchain:internal"


def fail_on_worker(*_: object, **__: object) -> None:
    """Fail as a worker that cannot return its result."""
    raise ValueError("worker failed")


@pytest.mark.soak  # each worker needs seconds to start
def test_a_recording_that_crashes_every_worker_affects_only_its_own_line(
    recording_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    killer = tmp_path / "killer.mcap"
    killer.write_bytes(recording_file.read_bytes())
    # a worker also holds the next recordings, which it loses when it dies
    others = [tmp_path / f"{k}.mcap" for k in range(3)]
    for other in others:
        other.write_bytes(recording_file.read_bytes())
    out = tmp_path / "lines.jsonl"
    # the workers inherit this module, which crashes them like an error in native code
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
