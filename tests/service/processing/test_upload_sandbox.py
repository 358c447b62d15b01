"""An untrusted recording cannot exhaust the memory or the time of the service, or crash it."""

import hashlib
import os
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import httpx2
import numpy as np
import pytest

from cell.devices import View
from cell.recording import RecordingHeader, RecordingWriter
from cell.recording.errors import NotMcapError, RecordingTooLargeError
from service.processing import upload_sandbox
from service.processing.recording_metadata import describe_recording
from service.processing.upload_sandbox import RecordingRefusedError, SandboxLimits, describe_untrusted_recording

AssertProblem = Callable[[httpx2.Response, int, str], str]


def replace_reader(monkeypatch: pytest.MonkeyPatch, body: str) -> None:
    """Make the process run `body` in place of reading the recording, after it has set its limits."""
    lines = "\n".join(f"    {line}" for line in body.splitlines())
    code = f"from service.processing import upload_sandbox_main as child\ndef describe(path):\n{lines}\n"
    code += "child.describe = describe\n"
    monkeypatch.setattr(upload_sandbox, "PROGRAM", code + "child.main()")


@pytest.fixture
def refused(recording_file: Path) -> Callable[..., str]:
    """Return a function that reads a recording with these limits, checks that it is refused and returns the message."""

    def read(**limits: float) -> str:
        with pytest.raises(RecordingRefusedError) as caught:
            describe_untrusted_recording("r1", recording_file, "00", SandboxLimits(**limits))  # type: ignore[arg-type] (numbers of either kind)
        assert caught.value.slug == "recording-refused"
        return str(caught.value)

    return read


def test_the_row_equals_that_of_reading_without_a_sandbox(recording_file: Path) -> None:
    sha256 = hashlib.sha256(recording_file.read_bytes()).hexdigest()
    untrusted = describe_untrusted_recording("r1", recording_file, sha256)
    trusted = describe_recording("r1", recording_file)
    assert vars(untrusted) | {"created_at": ""} == vars(trusted) | {"created_at": ""}


@pytest.mark.slow
def test_the_largest_recording_with_intensity_images_is_read(tmp_path: Path) -> None:
    header = RecordingHeader(1e-4, None, np.eye(4))
    view = View(
        index=0,
        depth=np.full((800, 1280), 5000, dtype=np.uint16),
        depth_unit_m=1e-4,
        K=np.array([[800.0, 0.0, 639.5], [0.0, 800.0, 399.5], [0.0, 0.0, 1.0]]),
        T_base_flange=np.eye(4),
        T_flange_camera=np.eye(4),
        intensity=np.full((800, 1280), 100, dtype=np.uint8),
    )
    with RecordingWriter(tmp_path / "large.mcap", header) as writer:
        for index in range(64):
            writer.write_view(replace(view, index=index))
    assert describe_untrusted_recording("r1", tmp_path / "large.mcap", "00").views == 64


def test_errors_of_the_reader_are_raised_unchanged(tmp_path: Path) -> None:
    (tmp_path / "a.mcap").write_bytes(b"GIF89a")
    with pytest.raises(NotMcapError, match=r"^a\.mcap is not an MCAP file"):
        describe_untrusted_recording("r1", tmp_path / "a.mcap", "00")
    with (tmp_path / "b.mcap").open("wb") as file:
        file.truncate(300 << 20)  # a sparse file takes no space
    with pytest.raises(RecordingTooLargeError, match="314572800 bytes"):
        describe_untrusted_recording("r1", tmp_path / "b.mcap", "00")


def test_a_recording_that_exhausts_the_memory_is_refused(
    monkeypatch: pytest.MonkeyPatch, refused: Callable[..., str]
) -> None:
    # small pieces that are written to, so that they are really allocated, until none are left
    replace_reader(monkeypatch, "kept = []\nwhile True:\n    kept.append(b'x' * 4096 * len(str(len(kept))))")
    assert "took more than 48 MiB of memory" in refused(memory_bytes=48 << 20)


def test_a_recording_that_announces_a_huge_array_is_refused(
    monkeypatch: pytest.MonkeyPatch, refused: Callable[..., str]
) -> None:
    replace_reader(monkeypatch, "import numpy\nnumpy.ones((1 << 35,), dtype='u1')")
    assert "took more than 224 MiB of memory" in refused()


def test_a_recording_that_never_ends_is_refused(monkeypatch: pytest.MonkeyPatch, refused: Callable[..., str]) -> None:
    replace_reader(monkeypatch, "while True:\n    pass")
    assert "took more than 1 s of CPU time" in refused(cpu_s=1)
    replace_reader(monkeypatch, "import time\ntime.sleep(1000)")
    began = time.monotonic()
    assert "was not read within 0.7 s" in refused(wall_s=0.7)
    assert time.monotonic() - began < 60


def test_unexpected_errors_and_output_of_the_reader_are_refused(
    monkeypatch: pytest.MonkeyPatch, refused: Callable[..., str]
) -> None:
    replace_reader(monkeypatch, "raise KeyError('x')")
    assert "unexpected KeyError" in refused()
    replace_reader(monkeypatch, "import sys\nwhile True:\n    sys.stdout.write('x' * 1000000)")
    assert "crashed the reader" in refused()


def test_the_process_cannot_write_fork_or_read_the_environment(
    monkeypatch: pytest.MonkeyPatch, refused: Callable[..., str], tmp_path: Path
) -> None:
    monkeypatch.setenv("POINTCHAIN_SECRET", "1")
    target = tmp_path / "written"
    attempts = f"""
import os
def fails(action):
    try:
        action()
    except OSError:
        return True
writes = lambda: open({str(target)!r}, "wb", 0).write(b"x")
assert fails(writes)
assert fails(lambda: [open("/dev/null") for _ in range(50)])
assert {os.geteuid()} == 0 or fails(os.fork)  # root may always fork
assert "POINTCHAIN_SECRET" not in os.environ
raise IndexError
"""
    replace_reader(monkeypatch, attempts)
    assert "unexpected IndexError" in refused()
    assert not target.exists() or target.read_bytes() == b""


@pytest.mark.problem("recording-refused")
def test_an_upload_that_crashes_the_reader_is_a_problem_and_leaves_nothing(
    client: httpx2.Client, recording_file: Path, assert_problem: AssertProblem, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = client.get("/api/recordings").json()
    replace_reader(monkeypatch, "import os\nos.abort()")
    answer = client.post("/api/recordings", content=recording_file.read_bytes())
    assert "crashed the reader" in assert_problem(answer, 422, "recording-refused")
    assert client.get("/api/recordings").json() == before
