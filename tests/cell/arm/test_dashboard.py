"""The dashboard client with the virtual controller and with faulty servers."""

import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import pytest

from cell.arm.dashboard import PORT, Dashboard, stop_program
from cell.errors import RobotUnreachableError
from cell.simulation.ur_controller.launcher import RunningController
from tests.cell.arm.virtual_arm import dashboard_commands, fresh
from tests.cell.loopback import free_host

pytestmark = pytest.mark.xdist_group("cell")  # one at a time, because each test runs several busy processes


@contextmanager
def peer(serve: Callable[[socket.socket], None]) -> Iterator[str]:
    """Yield the address of a server on the dashboard port that serves one connection by `serve`."""
    host = free_host()
    with socket.create_server((host, PORT)) as listener:

        def run() -> None:
            link, _ = listener.accept()
            with link:
                serve(link)

        thread = threading.Thread(target=run)
        thread.start()
        yield host
        thread.join(10.0)


def deadline(seconds: float = 5.0) -> float:
    """Return a deadline in monotonic seconds."""
    return time.monotonic() + seconds


def test_commands_return_the_answers(controller: RunningController):
    fresh(controller)
    with Dashboard(controller.host, deadline()) as dashboard:
        assert dashboard.ask("robotmode") == "Robotmode: RUNNING"
        assert dashboard.ask("safetystatus") == "Safetystatus: NORMAL"
        assert dashboard.ask("is in remote control") == "true"
        assert dashboard.ask("get robot model") == "UR5"


def test_a_stop_ends_a_program_and_fails_without_one(controller: RunningController):
    begin = fresh(controller)
    controller.admin.foreign_program()
    assert stop_program(controller.host, 5.0) == "Stopped"
    assert controller.admin.state().program_state == "STOPPED"
    assert stop_program(controller.host, 5.0).startswith("Failed")
    assert dashboard_commands(controller.admin.log(begin)) == ["stop", "stop"]


def test_an_unreachable_dashboard_is_reported():
    host = free_host()
    for action in (lambda: Dashboard(host, deadline()), lambda: stop_program(host, 5.0)):
        with pytest.raises(RobotUnreachableError, match=rf"{host}, port 29999 .*check arm\.host"):
            action()


def test_a_silent_server_is_reported_at_the_deadline():
    host = free_host()
    # No process accepts the connection, but the kernel completes it.
    with socket.create_server((host, PORT)):
        for action in (lambda: Dashboard(host, deadline(0.2)), lambda: stop_program(host, 0.2)):
            begin = time.monotonic()
            with pytest.raises(RobotUnreachableError, match="accepts connections but does not answer"):
                action()
            # One second is allowed for a busy machine.
            assert 0.15 < time.monotonic() - begin < 1.2


def test_a_server_that_disconnects_or_sends_an_endless_line_is_reported():
    def hang_up(link: socket.socket) -> None:
        link.sendall(b"Connected: Universal Robots Dashboard Server\n")
        link.recv(100)

    def babble(link: socket.socket) -> None:
        link.sendall(b"x" * 5000)
        link.recv(100)

    silent = pytest.raises(RobotUnreachableError, match="does not answer 'robotmode'")
    with peer(hang_up) as host, Dashboard(host, deadline()) as dashboard, silent:
        dashboard.ask("robotmode")
    with peer(babble) as host, pytest.raises(RobotUnreachableError, match="does not answer"):
        Dashboard(host, deadline())


def test_a_stop_is_sent_before_the_greeting_arrives():
    received: list[bytes] = []

    def slow_to_greet(link: socket.socket) -> None:
        received.append(link.recv(100))
        link.sendall(b"Connected: Universal Robots Dashboard Server\nStopped\n")
        received.append(link.recv(100))

    with peer(slow_to_greet) as host:
        assert stop_program(host, 5.0) == "Stopped"
    assert received == [b"stop\n", b""]
