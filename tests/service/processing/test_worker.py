"""The recognition process as the service sees it: no task gets another's answer, and no failure is for ever."""

import errno
import os
import resource
import signal
import sqlite3
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from cell.devices import View
from cell.errors import RobotLostError
from cell.recording.header import RecordingHeader
from cell.recording.writer import read_recording
from recognition.grasping.gripper import Gripper
from service.processing.preview import draw_preview
from service.processing.results import recognise_recording
from service.processing.worker import RecognitionWorker, TaskFailedError
from service.processing.worker_main import Task, _draw

PATIENCE_S = 60.0
"""Only bounds a hang."""


@pytest.fixture
def worker() -> Iterator[RecognitionWorker]:
    worker = RecognitionWorker()
    yield worker
    worker.close()


def task(source: Path | RecordingHeader, folder: Path, name: str) -> Task:
    return Task(source, 0.0042, "graph", Gripper(), folder / name, folder / f"{name}.png")


@contextmanager
def lowered(kind: int, soft: int) -> Iterator[None]:
    """A limit of this process, for a moment."""
    before = resource.getrlimit(kind)
    resource.setrlimit(kind, (soft, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(kind, before)


def open_files() -> set[int]:
    files = list(Path("/dev/fd").iterdir())  # with that of the listing itself
    return {int(file.name) for file in files if file.exists()}


def test_a_task_that_was_broken_off_leaves_no_answer_to_the_next(
    worker: RecognitionWorker, recording_file: Path, tmp_path: Path
) -> None:
    def locked(stage: str) -> None:
        raise sqlite3.OperationalError("database is locked")

    worker.start()
    with pytest.raises(sqlite3.OperationalError):
        worker.run(task(recording_file, tmp_path, "first"), locked, PATIENCE_S)
    worker.start()
    worker.run(task(recording_file, tmp_path, "second"), lambda _: None, PATIENCE_S)
    assert (tmp_path / "second" / "model.json").exists(), "this was the answer to the first"


def test_a_scan_that_is_broken_off_does_not_cost_the_process(
    worker: RecognitionWorker, recording_file: Path, tmp_path: Path
) -> None:
    recording = read_recording(recording_file)

    def until_the_arm_is_lost() -> Iterator[View]:
        yield from recording.views[:2]
        raise RobotLostError("the robot is gone")

    worker.start()
    process = worker._process
    for number in range(2):
        live = task(recording.header, tmp_path, f"broken off {number}")
        with pytest.raises(RobotLostError):
            worker.run(live, lambda _: None, PATIENCE_S, until_the_arm_is_lost())
    assert worker.alive
    assert worker._process is process
    worker.run(task(recording_file, tmp_path, "next"), lambda _: None, PATIENCE_S)
    assert (tmp_path / "next" / "model.json").exists()
    assert not (tmp_path / "broken off 0").exists()


def test_a_refused_task_does_not_cost_the_process(worker: RecognitionWorker, tmp_path: Path) -> None:
    worker.start()
    (tmp_path / "none.mcap").write_bytes(b"")
    with pytest.raises(TaskFailedError):
        worker.run(task(tmp_path / "none.mcap", tmp_path, "none"), lambda _: None, PATIENCE_S)
    assert worker.alive


def test_a_process_that_hangs_is_ended_whatever_it_is_sent(worker: RecognitionWorker, tmp_path: Path) -> None:
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
            # More than any pipe holds.
            worker.run(task(header, tmp_path, "hung"), lambda _: None, 0.2, missing=("x" * 4_000_000,))
    finally:
        rescue.cancel()
    assert failed.value.failure.slug == "recognition-timeout"


# For the pipe to it, and for starting it: as many are free as let the first, or only the second, fail.
@pytest.mark.parametrize("free", [0, 3])
def test_a_process_that_cannot_be_started_is_told_and_tried_again(worker: RecognitionWorker, free: int) -> None:
    used = open_files()
    limit = [number for number in range(max(used) + 9) if number not in used][free]
    with lowered(resource.RLIMIT_NOFILE, limit):
        worker.prepare()
        not_ready = worker.not_ready
        with pytest.raises(TaskFailedError) as failed:
            worker.start()
    assert failed.value.failure.slug == "recognition-crashed"
    assert not_ready is not None
    assert os.strerror(errno.EMFILE) in not_ready
    assert open_files() <= used  # what an earlier test has left may be closed meanwhile
    worker.prepare()
    assert worker.not_ready is None


def test_a_picture_that_cannot_be_written_whole_is_not_left(recording_file: Path, tmp_path: Path) -> None:
    recognition, picture = recognise_recording(recording_file), tmp_path / "picture.png"
    draw_preview(recognition.model, np.zeros((0, 3)))  # what drawing itself keeps on the disk is there by now
    with lowered(resource.RLIMIT_FSIZE, 1000):  # as a disk that gets full half way
        _draw(recognition, picture)
    assert not picture.exists()
    _draw(recognition, picture)
    assert picture.read_bytes().startswith(b"\x89PNG")
