"""The plain-socket dashboard client, against the virtual controller and against peers that misbehave."""

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

pytestmark = pytest.mark.xdist_group("cell")  # one at a time: each is several busy processes


@contextmanager
def peer(serve: Callable[[socket.socket], None]) -> Iterator[str]:
    """Something that listens on the dashboard's port and serves one connection as told; its address."""
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


def soon(seconds: float = 5.0) -> float:
    return time.monotonic() + seconds


def test_it_asks_and_gives_the_answers(controller: RunningController):
    fresh(controller)
    with Dashboard(controller.host, soon()) as dashboard:
        assert dashboard.ask("robotmode") == "Robotmode: RUNNING"
        assert dashboard.ask("safetystatus") == "Safetystatus: NORMAL"
        assert dashboard.ask("is in remote control") == "true"
        assert dashboard.ask("get robot model") == "UR5"


def test_stopping_ends_a_program_and_without_one_says_so(controller: RunningController):
    begin = fresh(controller)
    controller.admin.foreign_program()
    assert stop_program(controller.host, 5.0) == "Stopped"
    assert controller.admin.state().program_state == "STOPPED"
    assert stop_program(controller.host, 5.0).startswith("Failed")
    assert dashboard_commands(controller.admin.log(begin)) == ["stop", "stop"]


def test_nobody_there_is_told_with_what_to_check():
    host = free_host()
    for action in (lambda: Dashboard(host, soon()), lambda: stop_program(host, 5.0)):
        with pytest.raises(RobotUnreachableError, match=rf"{host}, port 29999 .*check arm\.host"):
            action()


def test_a_peer_that_never_answers_costs_the_deadline_and_no_more():
    host = free_host()
    # A listening socket that nobody serves: the kernel takes the connection.
    with socket.create_server((host, PORT)):
        for action in (lambda: Dashboard(host, soon(0.2)), lambda: stop_program(host, 0.2)):
            begin = time.monotonic()
            with pytest.raises(RobotUnreachableError, match="accepts connections but does not answer"):
                action()
            # A second for a busy machine.
            assert 0.15 < time.monotonic() - begin < 1.2


def test_a_peer_that_hangs_up_or_talks_without_end_is_told_as_such():
    def hang_up(link: socket.socket) -> None:
        link.sendall(b"Connected: Universal Robots Dashboard Server\n")
        link.recv(100)

    def babble(link: socket.socket) -> None:
        link.sendall(b"x" * 5000)
        link.recv(100)

    silent = pytest.raises(RobotUnreachableError, match="does not answer 'robotmode'")
    with peer(hang_up) as host, Dashboard(host, soon()) as dashboard, silent:
        dashboard.ask("robotmode")
    with peer(babble) as host, pytest.raises(RobotUnreachableError, match="does not answer"):
        Dashboard(host, soon())


def test_the_stop_leaves_before_the_greeting_has_come():
    received: list[bytes] = []

    def slow_to_greet(link: socket.socket) -> None:
        received.append(link.recv(100))
        link.sendall(b"Connected: Universal Robots Dashboard Server\nStopped\n")
        received.append(link.recv(100))

    with peer(slow_to_greet) as host:
        assert stop_program(host, 5.0) == "Stopped"
    assert received == [b"stop\n", b""]
