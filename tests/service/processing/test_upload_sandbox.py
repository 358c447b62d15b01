"""A recording of a stranger takes neither the service's memory, nor its time, nor the service itself."""

import hashlib
import os
import time
from collections.abc import Callable
from pathlib import Path

import httpx
import pytest

from cell.recording.errors import NotMcapError, RecordingTooLargeError
from service.processing import upload_sandbox
from service.processing.recording_metadata import describe_recording
from service.processing.upload_sandbox import ChildLimits, RecordingRefusedError, describe_foreign_recording

AssertProblem = Callable[[httpx.Response, int, str], str]


def program(monkeypatch: pytest.MonkeyPatch, body: str) -> None:
    """Has the process meet this instead of the recording, behind its limits."""
    lines = "\n".join(f"    {line}" for line in body.splitlines())
    code = f"from service.processing import upload_sandbox_main as child\ndef describe(path):\n{lines}\n"
    code += "child.describe = describe\n"
    monkeypatch.setattr(upload_sandbox, "PROGRAM", code + "child.main()")


@pytest.fixture
def refused(recording_file: Path) -> Callable[..., str]:
    """`refused(...)`: reading a recording within these limits is refused; the words."""

    def read(**limits: float) -> str:
        with pytest.raises(RecordingRefusedError) as caught:
            describe_foreign_recording("r1", recording_file, "00", ChildLimits(**limits))  # type: ignore[arg-type] (numbers of either kind)
        assert caught.value.slug == "recording-refused"
        return str(caught.value)

    return read


def test_it_tells_what_reading_it_here_does(recording_file: Path) -> None:
    sha256 = hashlib.sha256(recording_file.read_bytes()).hexdigest()
    foreign, here = describe_foreign_recording("r1", recording_file, sha256), describe_recording("r1", recording_file)
    assert vars(foreign) | {"created_at": ""} == vars(here) | {"created_at": ""}


def test_what_the_reader_refuses_comes_back_as_it_is(tmp_path: Path) -> None:
    (tmp_path / "a.mcap").write_bytes(b"GIF89a")
    with pytest.raises(NotMcapError, match=r"^a\.mcap is not an MCAP file"):
        describe_foreign_recording("r1", tmp_path / "a.mcap", "00")
    with (tmp_path / "b.mcap").open("wb") as file:
        file.truncate(300 << 20)  # sparse: it takes no space
    with pytest.raises(RecordingTooLargeError, match="314572800 bytes"):
        describe_foreign_recording("r1", tmp_path / "b.mcap", "00")


def test_one_that_takes_all_memory(monkeypatch: pytest.MonkeyPatch, refused: Callable[..., str]) -> None:
    # Touched, so that it would be taken; and in small pieces, until there are none left.
    program(monkeypatch, "kept = []\nwhile True:\n    kept.append(b'x' * 4096 * len(str(len(kept))))")
    assert "took more than 48 MiB of memory" in refused(memory_bytes=48 << 20)


def test_one_that_announces_what_nobody_has(monkeypatch: pytest.MonkeyPatch, refused: Callable[..., str]) -> None:
    program(monkeypatch, "import numpy\nnumpy.ones((1 << 35,), dtype='u1')")
    assert "took more than 160 MiB of memory" in refused()


def test_one_that_never_ends(monkeypatch: pytest.MonkeyPatch, refused: Callable[..., str]) -> None:
    program(monkeypatch, "while True:\n    pass")
    assert "took more than 1 s on a core" in refused(cpu_s=1)
    program(monkeypatch, "import time\ntime.sleep(1000)")
    began = time.monotonic()
    assert "was not read within 0.7 s" in refused(wall_s=0.7)
    assert time.monotonic() - began < 60


def test_one_that_makes_the_reader_say_anything(monkeypatch: pytest.MonkeyPatch, refused: Callable[..., str]) -> None:
    program(monkeypatch, "raise KeyError('x')")
    assert "unexpected KeyError" in refused()
    program(monkeypatch, "import sys\nwhile True:\n    sys.stdout.write('x' * 1000000)")
    assert "crashed the reader" in refused()


def test_the_process_can_write_start_and_see_little(
    monkeypatch: pytest.MonkeyPatch, refused: Callable[..., str], tmp_path: Path
) -> None:
    monkeypatch.setenv("POINTCHAIN_SECRET", "1")
    target = tmp_path / "written"
    tried = f"""
import os
def fails(action):
    try:
        action()
    except OSError:
        return True
writes = lambda: open({str(target)!r}, "wb", 0).write(b"x")
assert fails(writes)
assert fails(lambda: [open("/dev/null") for _ in range(50)])
assert {os.geteuid()} == 0 or fails(os.fork)  # root may always
assert "POINTCHAIN_SECRET" not in os.environ
raise IndexError
"""
    program(monkeypatch, tried)
    assert "unexpected IndexError" in refused()
    assert not target.exists() or target.read_bytes() == b""


def test_one_that_crashes_the_reader_is_a_problem_and_leaves_nothing(
    client: httpx.Client, recording_file: Path, assert_problem: AssertProblem, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = client.get("/api/recordings").json()
    program(monkeypatch, "import os\nos.abort()")
    answer = client.post("/api/recordings", content=recording_file.read_bytes())
    assert "crashed the reader" in assert_problem(answer, 422, "recording-refused")
    assert client.get("/api/recordings").json() == before
