"""The recognition process as the service sees it: no task gets the answer to another, and each failure is temporary."""

import errno
import os
import resource
import signal
import sqlite3
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cell.control.progress import MissingView
from cell.devices import View
from cell.errors import RobotLostError
from cell.recording import read_recording
from cell.recording.header import RecordingHeader
from recognition.request import RecognitionRequest
from service.processing.preview import draw_preview
from service.processing.results import recognise_recording
from service.processing.worker import RecognitionWorker, TaskFailedError
from service.processing.worker_main import Task, _draw_preview

PATIENCE_S = 60.0
"""Timeout that only a hanging process reaches."""


@pytest.fixture
def worker() -> Iterator[RecognitionWorker]:
    worker = RecognitionWorker()
    yield worker
    worker.close()


def make_task(source: Path | RecordingHeader, folder: Path, name: str) -> Task:
    return Task(source, RecognitionRequest(radius_m=0.0042), folder / name, folder / f"{name}.png")


@contextmanager
def lowered_limit(kind: int, soft: int) -> Iterator[None]:
    """Lower a resource limit of this process inside the context."""
    before = resource.getrlimit(kind)
    resource.setrlimit(kind, (soft, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(kind, before)


def open_files() -> set[int]:
    """Return the numbers of the open files."""
    files = list(Path("/dev/fd").iterdir())  # includes the file of the listing itself
    return {int(file.name) for file in files if file.exists()}


def test_a_failed_task_leaves_no_answer_to_the_next(
    worker: RecognitionWorker, recording_file: Path, tmp_path: Path
) -> None:
    def raise_locked(stage: str) -> None:
        raise sqlite3.OperationalError("database is locked")

    worker.start()
    with pytest.raises(sqlite3.OperationalError):
        worker.run(make_task(recording_file, tmp_path, "first"), raise_locked, PATIENCE_S)
    worker.start()
    worker.run(make_task(recording_file, tmp_path, "second"), lambda _: None, PATIENCE_S)
    assert (tmp_path / "second" / "cloud.ply").exists(), "this was the answer to the first task"


def test_the_process_survives_a_cancelled_scan(worker: RecognitionWorker, recording_file: Path, tmp_path: Path) -> None:
    recording = read_recording(recording_file)

    def views_until_the_robot_is_lost() -> Iterator[View]:
        yield from recording.views[:2]
        raise RobotLostError("the robot is gone")

    worker.start()
    process = worker._process
    for number in range(2):
        live = make_task(recording.header, tmp_path, f"cancelled {number}")
        with pytest.raises(RobotLostError):
            worker.run(live, lambda _: None, PATIENCE_S, views_until_the_robot_is_lost())
    assert worker.alive
    assert worker._process is process
    worker.run(make_task(recording_file, tmp_path, "next"), lambda _: None, PATIENCE_S)
    assert (tmp_path / "next" / "cloud.ply").exists()
    assert not (tmp_path / "cancelled 0").exists()


@pytest.mark.parametrize(("next_is_here", "checks"), [(False, [3, 4]), (True, [3])])
def test_views_are_not_checked_while_the_next_one_is_here(
    worker: RecognitionWorker, recording_file: Path, tmp_path: Path, next_is_here: bool, checks: list[int]
) -> None:
    recording, checked = read_recording(recording_file), []
    worker.start()
    task = replace(make_task(recording.header, tmp_path, "live"), check_views=True)
    outcome = worker.run(
        task,
        lambda _: None,
        PATIENCE_S,
        iter(recording.views),
        on_check=lambda check: checked.append(check.views),
        next_is_here=lambda: next_is_here,
    )
    assert checked == checks
    assert [view.index for view in outcome.views] == [0, 1, 2, 3]


def test_the_process_survives_a_refused_task(worker: RecognitionWorker, tmp_path: Path) -> None:
    worker.start()
    (tmp_path / "none.mcap").write_bytes(b"")
    with pytest.raises(TaskFailedError):
        worker.run(make_task(tmp_path / "none.mcap", tmp_path, "none"), lambda _: None, PATIENCE_S)
    assert worker.alive


def test_a_hanging_process_is_killed_while_a_message_is_sent(worker: RecognitionWorker, tmp_path: Path) -> None:
    worker.start()
    process = worker._process
    assert process is not None
    assert process.pid is not None
    os.kill(process.pid, signal.SIGSTOP)
    rescue = threading.Timer(PATIENCE_S, process.kill)
    rescue.start()
    header = RecordingHeader(depth_unit_m=1e-4, string_radius_m=0.0042, T_flange_camera=np.eye(4))
    try:
        with pytest.raises(TaskFailedError) as failed:
            # more than the buffer of any pipe
            worker.run(
                make_task(header, tmp_path, "hung"), lambda _: None, 0.2, missing=(MissingView(0, "x" * 4_000_000),)
            )
    finally:
        rescue.cancel()
    assert failed.value.failure.slug == "recognition-timeout"


# with no free file the pipe fails, and with three only the start of the process
@pytest.mark.parametrize("free", [0, 3])
def test_a_failed_start_is_reported_and_tried_again(worker: RecognitionWorker, free: int) -> None:
    used = open_files()
    limit = [number for number in range(max(used) + 9) if number not in used][free]
    with lowered_limit(resource.RLIMIT_NOFILE, limit):
        worker.prepare()
        reason = worker.not_ready_reason
        with pytest.raises(TaskFailedError) as failed:
            worker.start()
    assert failed.value.failure.slug == "recognition-crashed"
    assert reason is not None
    assert os.strerror(errno.EMFILE) in reason
    assert open_files() <= used  # files of an earlier test may be closed meanwhile
    worker.prepare()
    worker.start()
    assert worker.not_ready_reason is None


def test_a_start_in_advance_does_not_wait_for_the_process(worker: RecognitionWorker) -> None:
    worker.prepare()
    assert worker.alive
    assert worker.starting, "the call waited for the imports of the process"
    assert worker.not_ready_reason == "recognition is starting"
    process, deadline = worker._process, time.monotonic() + PATIENCE_S
    while worker.not_ready_reason is not None and time.monotonic() < deadline:
        time.sleep(0.01)
        worker.prepare()
    assert not worker.starting
    worker.start()
    assert (worker._process, worker.start_count) == (process, 1)


def test_the_service_does_not_import_what_only_recognition_needs() -> None:
    """These imports take a quarter of the CPU time of the service's start."""
    names = ("recognition.pipeline", "scipy.interpolate", "scipy.optimize", "matplotlib")
    program = f"import sys, service.cli.commands.serve; print([name for name in {names} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60, check=True)
    assert done.stdout.strip() == "[]"


def test_a_process_that_dies_during_its_start_is_replaced(worker: RecognitionWorker) -> None:
    worker.prepare()
    process = worker._process
    assert process is not None
    process.kill()
    process.join()
    worker.prepare()
    assert worker.alive
    worker.start()
    assert (worker.not_ready_reason, worker.start_count) == (None, 2)


def test_an_incomplete_preview_is_removed(recording_file: Path, tmp_path: Path) -> None:
    recognition, preview = recognise_recording(recording_file), tmp_path / "preview.png"
    draw_preview(recognition.model, np.zeros((0, 3)))  # so that the files that drawing itself caches exist
    with lowered_limit(resource.RLIMIT_FSIZE, 1000):  # like a disk that fills up during the write
        _draw_preview(recognition, preview)
    assert not preview.exists()
    _draw_preview(recognition, preview)
    assert preview.read_bytes().startswith(b"\x89PNG")


def test_the_process_is_ready_before_it_imports_matplotlib_and_works_without_it(
    worker: RecognitionWorker, recording_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    importing, go_on = tmp_path / "importing", tmp_path / "go-on"
    (tmp_path / "broken").mkdir()
    (tmp_path / "broken" / "matplotlib.py").write_text(
        "import pathlib, time\n"
        f"pathlib.Path({str(importing)!r}).touch()\n"
        f"while not pathlib.Path({str(go_on)!r}).exists():\n    time.sleep(0.01)\n"
        "raise ImportError('libfreetype.so.6: cannot open shared object file')\n"
    )
    monkeypatch.syspath_prepend(tmp_path / "broken")  # the process has the path of this one
    worker.start()
    assert worker.not_ready_reason is None
    deadline = time.monotonic() + PATIENCE_S
    while not importing.exists() and time.monotonic() < deadline:
        time.sleep(0.01)
    assert importing.exists(), "the idle process does not warm up the drawing"
    go_on.touch()
    task = make_task(recording_file, tmp_path, "scan")
    worker.run(task, lambda _: None, PATIENCE_S)
    assert worker.wait_for_preview()
    assert (task.results / "cloud.ply").exists()
    assert not task.preview.exists()
