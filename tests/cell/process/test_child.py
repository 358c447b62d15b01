"""A driver in a child process: calls, faults, hangs, and the end of the process."""

import os
import re
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from cell.errors import CellError, MotionError
from cell.process.child import Child, ChildBusyError, ChildLostError, NotCalledError
from tests.cell.process.child_drivers import BrokenWhenIdle, Counted, Driver, refusing
from tests.processes import runs

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[3]


@pytest.fixture
def child():
    child = Child("test", Driver, 100)
    yield child
    child.close()


def test_calls_return_what_the_driver_returns(child: Child):
    assert child.call("add", 1, 2, timeout_s=10.0) == 103
    assert child.alive


def test_errors_of_the_driver_are_raised_unchanged(child: Child):
    with pytest.raises(MotionError, match="the robot refuses"):
        child.call("refuse", timeout_s=10.0)
    assert child.call("add", 1, 2, timeout_s=10.0) == 103


def test_an_unexpected_error_is_reported_and_the_child_continues(child: Child):
    with pytest.raises(CellError, match="fail raised an unexpected KeyError"):
        child.call("fail", timeout_s=10.0)
    assert child.call("add", 0, 0, timeout_s=10.0) == 100


def test_a_driver_that_cannot_be_created_reports_why():
    child = Child("test", refusing)
    try:
        with pytest.raises(CellError, match="no device here"):
            child.call("add", 1, 2, timeout_s=10.0)
    finally:
        child.close()


def test_closing_does_not_create_a_driver(tmp_path: Path):
    """A new driver would open the device again, which was never used or has just failed."""
    attempts = tmp_path / "attempts"
    Child("test", Counted, attempts, True).close()
    assert not attempts.exists()
    child = Child("test", Counted, attempts, False)
    with pytest.raises(CellError, match="no device here"):
        child.call("add", 1, 2, timeout_s=10.0)
    child.close()
    assert attempts.read_text() == "opened\n"


def test_a_hanging_child_is_killed(child: Child):
    child.call("add", 0, 0, timeout_s=10.0)
    with pytest.raises(ChildLostError, match=r"did not answer 'sleep' within 0\.1 s"):
        child.call("sleep", 60.0, timeout_s=0.1)
    assert not child.alive
    with pytest.raises(ChildLostError):
        child.call("add", 1, 2, timeout_s=10.0)


LATE_PARENT = """
import sys
from pathlib import Path
from cell.process.child import Child, ChildLostError
from tests.cell.process.child_drivers import Driver
child = Child("test", Driver)
child.call("add", 0, 0, timeout_s=10.0)
try:
    child.call("hang", Path(sys.argv[1]), timeout_s=2.0)
except ChildLostError as error:
    print(error, flush=True)
child.close()
"""


def test_a_computer_that_stood_still_is_named(tmp_path: Path):
    begun, command = tmp_path / "begun", [sys.executable, "-c", LATE_PARENT]
    with subprocess.Popen([*command, str(begun)], cwd=ROOT, stdout=subprocess.PIPE, text=True) as parent:
        assert parent.stdout is not None
        while not begun.exists():
            time.sleep(0.01)
        parent.send_signal(signal.SIGSTOP)
        time.sleep(1.0)
        parent.send_signal(signal.SIGCONT)
        message = parent.stdout.readline()
    found = re.search(r"did not answer 'hang' within 2 s; this computer was (\d+\.\d) s late meanwhile", message)
    assert found is not None, message
    assert float(found[1]) >= 0.9


def test_a_child_that_hangs_during_its_answer_is_killed(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("cell.process.child.HALF_S", 1)
    child = Child("test", Driver)
    assert len(child.call("picture", timeout_s=10.0)) == 5_000_000
    poll = child._pipe.poll

    def freeze_once_it_answers(timeout_s: float) -> bool:
        answers = poll(timeout_s)
        os.kill(child.pid, signal.SIGSTOP)
        return answers

    monkeypatch.setattr(child._pipe, "poll", freeze_once_it_answers)
    lost: list[ChildLostError] = []

    def call() -> None:
        with pytest.raises(ChildLostError, match="closed the connection during its answer to 'picture'") as caught:
            child.call("picture", timeout_s=10.0)
        lost.append(caught.value)

    caller = threading.Thread(target=call, daemon=True)
    caller.start()
    caller.join(20.0)
    child.kill()
    assert lost
    child.close()


def interrupt(number: int, frame: object) -> None:
    raise KeyboardInterrupt


def test_the_answer_to_an_interrupted_call_is_discarded(child: Child):
    child.call("add", 0, 0, timeout_s=10.0)
    before = signal.signal(signal.SIGUSR1, interrupt)
    try:
        threading.Timer(0.1, os.kill, (os.getpid(), signal.SIGUSR1)).start()
        with pytest.raises(KeyboardInterrupt):
            child.call("sleep", 0.5, timeout_s=10.0)
    finally:
        signal.signal(signal.SIGUSR1, before)
    with pytest.raises(ChildLostError, match="has ended"):
        child.call("add", 1, 2, timeout_s=10.0)


def test_a_crash_is_detected_and_named(child: Child):
    child.call("add", 0, 0, timeout_s=10.0)
    with pytest.raises(ChildLostError, match=rf"exit code -{signal.SIGABRT.value}"):
        child.call("crash", timeout_s=10.0)


def test_killing_the_child_from_another_thread_ends_a_call(child: Child):
    child.call("add", 0, 0, timeout_s=10.0)
    threading.Timer(0.1, child.kill).start()
    with pytest.raises(ChildLostError, match="has ended"):
        child.call("sleep", 60.0, timeout_s=30.0)


def hold(child: Child, go_on: Path, answers: list[str]) -> threading.Thread:
    """Let another thread keep the child busy until the file exists, and return it when its call has the turn."""
    busy = threading.Thread(target=lambda: answers.append(child.call("wait_for", go_on, timeout_s=60.0)))
    busy.start()
    while not child._turn.locked():
        time.sleep(0.001)
    return busy


def test_calls_are_sequential_and_a_call_may_refuse_to_wait(child: Child, tmp_path: Path):
    child.call("add", 0, 0, timeout_s=10.0)
    answers: list[str] = []
    busy = hold(child, tmp_path / "go-on", answers)
    with pytest.raises(ChildBusyError):
        child.call("add", 1, 2, timeout_s=10.0, turn_s=0.01)
    threading.Timer(0.1, (tmp_path / "go-on").touch).start()
    assert child.call("add", 1, 2, timeout_s=10.0) == 103
    busy.join()
    assert answers == ["waited"]


def test_a_call_that_became_obsolete_while_waiting_is_not_sent(child: Child, tmp_path: Path):
    child.call("add", 0, 0, timeout_s=10.0)
    unwanted = threading.Event()
    assert child.call("add", 1, 2, timeout_s=10.0, unless=unwanted) == 103
    busy = hold(child, tmp_path / "go-on", [])

    def cancel() -> None:
        unwanted.set()
        (tmp_path / "go-on").touch()

    threading.Timer(0.1, cancel).start()
    with pytest.raises(NotCalledError, match="'add' of the test process was cancelled"):
        child.call("add", 1, 2, timeout_s=10.0, unless=unwanted)
    busy.join()
    assert child.call("add", 0, 0, timeout_s=10.0) == 100


def test_the_driver_is_idle_between_calls(child: Child):
    child.call("add", 0, 0, timeout_s=10.0)
    earlier = 0
    quiet: list[float] = []
    deadline = time.monotonic() + 30.0
    while len(quiet) < 3:  # every 0.02 s in theory, less often on a busy machine
        assert time.monotonic() < deadline
        time.sleep(0.3)
        every = child.call("quiet_times", timeout_s=10.0)
        quiet = every[earlier:]
        earlier = len(every)
    assert quiet == sorted(quiet)
    assert quiet[0] >= Driver.IDLE_S


def test_an_error_while_idle_ends_the_process():
    child = Child("test", BrokenWhenIdle)
    try:
        child.call("add", 0, 0, timeout_s=10.0)
        deadline = time.monotonic() + 10.0
        while child.alive and time.monotonic() < deadline:
            time.sleep(0.01)
        with pytest.raises(ChildLostError, match="exit code 1"):
            child.call("add", 1, 2, timeout_s=10.0)
    finally:
        child.close()


def test_sigterm_and_ctrl_c_do_not_end_the_child(child: Child):
    child.call("add", 0, 0, timeout_s=10.0)
    for number in (signal.SIGTERM, signal.SIGINT):
        os.kill(child.pid, number)
    assert child.call("add", 1, 2, timeout_s=10.0) == 103


def test_output_of_a_library_does_not_go_to_stdout(capfd: pytest.CaptureFixture[str]):
    child = Child("test", Driver)  # started while the output is captured
    child.call("chatter", timeout_s=10.0)
    child.close()
    captured = capfd.readouterr()
    assert "vendor chatter" not in captured.out
    assert "vendor chatter" in captured.err


def test_many_children_leak_nothing():
    def open_files() -> int:
        return len(list(Path("/proc/self/fd").iterdir()))

    def once() -> int:
        child = Child("test", Driver)
        child.call("add", 1, 2, timeout_s=10.0)
        child.close()
        return child.pid

    files, threads = open_files(), threading.active_count()
    pids = [once() for _ in range(5)]
    assert open_files() <= files
    assert threading.active_count() == threads
    assert not any(map(runs, pids))


PARENT = """
import sys, time
sys.path.insert(0, {root!r})
from cell.process.child import Child
from tests.cell.process.child_drivers import Driver
child = Child("test", Driver)
child.call("add", 1, 2, timeout_s=30.0)
print(child.pid, flush=True)
{then}
"""


@pytest.mark.parametrize("then", ["time.sleep(60)", "pass", "child.call('sleep', 60.0, timeout_s=60.0)"])
def test_the_child_ends_with_its_parent(tmp_path: Path, then: str):
    """The parent is killed, ends without closing the child, or is killed during a call."""
    root = str(Path(__file__).parents[3])
    script = tmp_path / "parent.py"
    script.write_text(PARENT.format(root=root, then=then))
    with subprocess.Popen([sys.executable, str(script)], stdout=subprocess.PIPE, text=True) as parent:
        assert parent.stdout is not None
        pid = int(parent.stdout.readline())
        if then != "pass":
            parent.kill()
        assert parent.wait(timeout=20.0) == (0 if then == "pass" else -signal.SIGKILL)
    deadline = time.monotonic() + 10.0
    while runs(pid) and time.monotonic() < deadline:
        time.sleep(0.02)
    assert not runs(pid)
