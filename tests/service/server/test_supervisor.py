"""The supervisor against services that die, hang, end, or never begin: small programs that speak as the real one."""

import os
import re
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import httpx
import pytest

from service.server import supervisor as supervisor_module
from service.server.heartbeat import Supervised
from tests.processes import children, runs
from tests.service.conftest import PATIENCE_S, wait_until
from tests.service.service_process import ROOT, answers

TOLD = 5
"""Exit code of a service that was told to end, and has."""

SUPERVISE = """
import sys
from service.server.supervisor import Patience, supervise
patience = Patience(start_s=20.0, silent_s=1.0, end_s=2.0, first_delay_s=0.05, longest_delay_s=0.1)
sys.exit(supervise(sys.argv[2:], [sys.executable, "-c", sys.argv[1]], patience))
"""

SERVICE = """
import os, pathlib, signal, socket, sys, time
options = dict(zip(sys.argv[1::2], sys.argv[2::2]))
line = socket.socket(fileno=int(options["--supervised"]))
signal.signal(signal.SIGTERM, lambda *_: sys.exit(5))
line.sendall(b"listening 4711" + bytes([10]))
with open(options["--lives"], "a") as lives:
    print(os.getpid(), options.get("--port", "first"), file=lives)
line.setblocking(False)
while True:
    line.sendall(b"beat" + bytes([10]))
    time.sleep(0.05)
    try:
        if not line.recv(1):
            sys.exit(7)  # the supervisor is gone
    except BlockingIOError:
        pass
"""


@contextmanager
def supervised(service: str, lives: Path) -> Iterator[subprocess.Popen[str]]:
    lives.touch()
    running = subprocess.Popen(
        [sys.executable, "-c", SUPERVISE, service, "--lives", str(lives)], cwd=ROOT, stderr=subprocess.PIPE, text=True
    )
    try:
        yield running
    finally:
        running.kill()
        running.communicate()
        for pid, _ in read(lives):
            if runs(pid):
                os.kill(pid, signal.SIGKILL)


def read(lives: Path) -> list[tuple[int, str]]:
    """Process ids and ports of the services so far that have said where they listen."""
    lines = [line.split() for line in lives.read_text().splitlines()]
    return [(int(pid), port) for pid, port in lines]


@pytest.mark.parametrize("ending", [signal.SIGKILL, signal.SIGSEGV, signal.SIGSTOP], ids=lambda s: s.name)
def test_a_service_that_dies_or_hangs_is_started_again_where_it_was(tmp_path: Path, ending: signal.Signals) -> None:
    lives = tmp_path / "lives"
    with supervised(SERVICE, lives) as supervisor:
        for number in range(1, 3):
            wait_until(lambda number=number: len(read(lives)) == number)
            os.kill(read(lives)[-1][0], ending)
        wait_until(lambda: len(read(lives)) == 3)
        assert [port for _, port in read(lives)] == ["first", "4711", "4711"]
        assert [runs(pid) for pid, _ in read(lives)] == [False, False, True]
        supervisor.send_signal(signal.SIGTERM)
        assert supervisor.wait(PATIENCE_S) == TOLD
        assert supervisor.stderr is not None
        said = supervisor.stderr.read()
    assert ("had not been heard from" if ending == signal.SIGSTOP else ending.name) in said


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT], ids=lambda s: s.name)
def test_told_to_end_it_tells_the_service_and_ends_with_it(tmp_path: Path, number: signal.Signals) -> None:
    lives = tmp_path / "lives"
    with supervised(SERVICE, lives) as supervisor:
        wait_until(lambda: len(read(lives)) == 1)
        supervisor.send_signal(number)
        assert supervisor.wait(PATIENCE_S) == TOLD
        assert not runs(read(lives)[0][0])
    assert len(read(lives)) == 1


def test_a_service_that_does_not_end_is_killed(tmp_path: Path) -> None:
    stubborn = SERVICE.replace("lambda *_: sys.exit(5)", "signal.SIG_IGN")
    lives = tmp_path / "lives"
    with supervised(stubborn, lives) as supervisor:
        wait_until(lambda: len(read(lives)) == 1)
        supervisor.terminate()
        supervisor.wait(PATIENCE_S)
        assert not runs(read(lives)[0][0])
    assert len(read(lives)) == 1


def test_a_service_that_never_began_has_said_why_and_is_not_started_again(tmp_path: Path) -> None:
    lives = tmp_path / "lives"
    with supervised("import sys; sys.exit(3)", lives) as supervisor:
        assert supervisor.wait(PATIENCE_S) == 3


def test_the_service_learns_that_its_supervisor_is_gone(tmp_path: Path) -> None:
    lives = tmp_path / "lives"
    with supervised(SERVICE, lives) as supervisor:
        wait_until(lambda: len(read(lives)) == 1)
        supervisor.kill()
        wait_until(lambda: not runs(read(lives)[0][0]))


def test_the_end_of_the_line_is_told_and_not_before() -> None:
    ours, theirs = socket.socketpair()
    supervised, ended = Supervised(theirs.detach()), threading.Event()
    with ours, supervised._line:
        supervised.when_it_ends(ended.set)
        supervised.listening(4711)
        assert ours.recv(100) == b"listening 4711\n"
        assert not ended.wait(0.2)
        ours.close()
        assert ended.wait(PATIENCE_S)


@pytest.mark.skipif(not Path("/proc").is_dir(), reason="looks for the service in /proc")
def test_the_real_service_is_started_again_at_its_address(tmp_path: Path) -> None:
    serve = "import sys; from service.cli.main import main; sys.exit(main(['serve', '--port', '0']))"
    environment = os.environ | {"POINTCHAIN_DATA_DIR": str(tmp_path / "data")}
    with (tmp_path / "log").open("wb") as output:
        supervisor = subprocess.Popen([sys.executable, "-c", serve], cwd=ROOT, env=environment, stderr=output)
    try:
        wait_until(lambda: "/docs" in (tmp_path / "log").read_text() or supervisor.poll() is not None)
        found = re.search(r"pointchain: (http://\S+) \(API", log := (tmp_path / "log").read_text())
        assert found is not None, log
        with httpx.Client(base_url=found[1], timeout=PATIENCE_S) as client:
            wait_until(lambda: answers(client))
            (service,) = children(supervisor.pid)
            os.kill(service, signal.SIGKILL)
            wait_until(lambda: not runs(service))
            wait_until(lambda: answers(client))
        supervisor.terminate()
        assert supervisor.wait(PATIENCE_S) == 0
    finally:
        supervisor.kill()
        supervisor.wait()
    assert "ended unexpectedly (SIGKILL); it is started again" in (tmp_path / "log").read_text()


def test_what_a_service_said_just_before_its_end_counts() -> None:
    """Whoever has listened is started again, however soon it died behind that."""
    supervisor = supervisor_module._Supervisor([], [], supervisor_module.Patience())
    ours, theirs = socket.socketpair()
    with ours, subprocess.Popen([sys.executable, "-c", ""]) as child:
        with theirs:
            theirs.sendall(b"listening 4711\n")
        child.wait(PATIENCE_S)
        assert supervisor._listen(ours, child) is None
    assert supervisor._port == "4711"
