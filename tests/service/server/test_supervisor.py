"""The supervisor with services that die, hang, end, or never start: small programs with the real protocol."""

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

import httpx2
import pytest

from service.server import supervisor as supervisor_module
from service.server.supervisor_link import SupervisorLink
from tests.processes import children, runs
from tests.service.conftest import PATIENCE_S, wait_until
from tests.service.service_process import ROOT, answers

TERMINATED = 5
"""Exit code of a service that has ended after SIGTERM."""

SUPERVISE = """
import sys
from service.server.supervisor import SupervisorTimeouts, supervise
timeouts = SupervisorTimeouts(
    start_s=20.0, heartbeat_s=1.0, shutdown_s=2.0, min_restart_delay_s=0.05, max_restart_delay_s=0.1
)
sys.exit(supervise(sys.argv[2:], [sys.executable, "-c", sys.argv[1]], timeouts))
"""

SERVICE = """
import os, pathlib, signal, socket, sys, time
options = dict(zip(sys.argv[1::2], sys.argv[2::2]))
line = socket.socket(fileno=int(options["--supervised"]))
signal.signal(signal.SIGTERM, lambda *_: sys.exit(5))
line.sendall(b"listening 4711" + bytes([10]))
with open(options["--starts"], "a") as starts:
    print(os.getpid(), options.get("--port", "first"), file=starts)
line.setblocking(False)
while True:
    line.sendall(b"beat" + bytes([10]))
    time.sleep(0.05)
    try:
        if not line.recv(1):
            sys.exit(7)  # the supervisor has ended
    except BlockingIOError:
        pass
"""


@contextmanager
def supervised(service: str, starts: Path) -> Iterator[subprocess.Popen[str]]:
    starts.touch()
    running = subprocess.Popen(
        [sys.executable, "-c", SUPERVISE, service, "--starts", str(starts)], cwd=ROOT, stderr=subprocess.PIPE, text=True
    )
    try:
        yield running
    finally:
        running.kill()
        running.communicate()
        for pid, _ in read_starts(starts):
            if runs(pid):
                os.kill(pid, signal.SIGKILL)


def read_starts(starts: Path) -> list[tuple[int, str]]:
    """Return the process id and port of each service that has reported its port."""
    lines = [line.split() for line in starts.read_text().splitlines()]
    return [(int(pid), port) for pid, port in lines]


@pytest.mark.parametrize("ending", [signal.SIGKILL, signal.SIGSEGV, signal.SIGSTOP], ids=lambda s: s.name)
def test_a_service_that_dies_or_hangs_is_started_again_on_its_port(tmp_path: Path, ending: signal.Signals) -> None:
    starts = tmp_path / "starts"
    with supervised(SERVICE, starts) as supervisor:
        for number in range(1, 3):
            wait_until(lambda number=number: len(read_starts(starts)) == number)
            os.kill(read_starts(starts)[-1][0], ending)
        wait_until(lambda: len(read_starts(starts)) == 3)
        assert [port for _, port in read_starts(starts)] == ["first", "4711", "4711"]
        assert [runs(pid) for pid, _ in read_starts(starts)] == [False, False, True]
        supervisor.send_signal(signal.SIGTERM)
        assert supervisor.wait(PATIENCE_S) == TERMINATED
        assert supervisor.stderr is not None
        log = supervisor.stderr.read()
    assert ("sent no heartbeat" if ending == signal.SIGSTOP else ending.name) in log


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT], ids=lambda s: s.name)
def test_a_signal_is_forwarded_and_ends_both(tmp_path: Path, number: signal.Signals) -> None:
    starts = tmp_path / "starts"
    with supervised(SERVICE, starts) as supervisor:
        wait_until(lambda: len(read_starts(starts)) == 1)
        supervisor.send_signal(number)
        assert supervisor.wait(PATIENCE_S) == TERMINATED
        assert not runs(read_starts(starts)[0][0])
    assert len(read_starts(starts)) == 1


def test_a_service_that_ignores_the_signal_is_killed(tmp_path: Path) -> None:
    stubborn = SERVICE.replace("lambda *_: sys.exit(5)", "signal.SIG_IGN")
    starts = tmp_path / "starts"
    with supervised(stubborn, starts) as supervisor:
        wait_until(lambda: len(read_starts(starts)) == 1)
        supervisor.terminate()
        supervisor.wait(PATIENCE_S)
        assert not runs(read_starts(starts)[0][0])
    assert len(read_starts(starts)) == 1


def test_a_service_that_never_listened_is_not_started_again(tmp_path: Path) -> None:
    starts = tmp_path / "starts"
    with supervised("import sys; sys.exit(3)", starts) as supervisor:
        assert supervisor.wait(PATIENCE_S) == 3


def test_the_service_notices_the_end_of_its_supervisor(tmp_path: Path) -> None:
    starts = tmp_path / "starts"
    with supervised(SERVICE, starts) as supervisor:
        wait_until(lambda: len(read_starts(starts)) == 1)
        supervisor.kill()
        wait_until(lambda: not runs(read_starts(starts)[0][0]))


def test_the_end_of_the_supervisor_is_reported_and_not_before() -> None:
    ours, theirs = socket.socketpair()
    link, ended = SupervisorLink(theirs.detach()), threading.Event()
    with ours, link._socket:
        link.on_supervisor_exit(ended.set)
        link.report_listening(4711)
        assert ours.recv(100) == b"listening 4711\n"
        assert not ended.wait(0.2)
        ours.close()
        assert ended.wait(PATIENCE_S)


@pytest.mark.skipif(not Path("/proc").is_dir(), reason="finds the service in /proc")
def test_the_real_service_is_started_again_at_its_address(tmp_path: Path) -> None:
    serve = "import sys; from service.cli.main import main; sys.exit(main(['serve', '--port', '0']))"
    environment = os.environ | {"POINTCHAIN_DATA_DIR": str(tmp_path / "data")}
    with (tmp_path / "log").open("wb") as output:
        supervisor = subprocess.Popen([sys.executable, "-c", serve], cwd=ROOT, env=environment, stderr=output)
    try:
        wait_until(lambda: "/docs" in (tmp_path / "log").read_text() or supervisor.poll() is not None)
        found = re.search(r"pointchain: (http://\S+) \(API", log := (tmp_path / "log").read_text())
        assert found is not None, log
        with httpx2.Client(base_url=found[1], timeout=PATIENCE_S) as client:
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


def test_the_last_message_of_a_service_is_read_after_its_end() -> None:
    """A service that has listened is started again, even if it died at once."""
    supervisor = supervisor_module._Supervisor([], [], supervisor_module.SupervisorTimeouts())
    ours, theirs = socket.socketpair()
    with ours, subprocess.Popen([sys.executable, "-c", ""]) as child:
        with theirs:
            theirs.sendall(b"listening 4711\n")
        child.wait(PATIENCE_S)
        assert supervisor._monitor(ours, child) is None
    assert supervisor._port == "4711"
