"""The supervisor: a process that only keeps the service running, so that few faults can end it.

The service reports its port and its heartbeats over a socket. A service that has died is started again; one that is
silent is killed first. When the supervisor dies, the socket closes, and the service shuts down cleanly. The supervisor
never stops the arm: a hung service does that itself, and for a dead or suspended one the controller does.
"""

import contextlib
import logging
import selectors
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from types import FrameType

log = logging.getLogger(__name__)

SERVE = (
    sys.executable,
    "-P",  # nothing is imported from the current folder
    "-c",
    "import sys; from service.cli.main import main; sys.exit(main(sys.argv[1:]))",
    "serve",
)


@dataclass(frozen=True)
class SupervisorTimeouts:
    """Timeouts and delays of the supervisor, seconds."""

    start_s: float = 60.0
    """Timeout for a service to listen."""
    heartbeat_s: float = 10.0
    """Timeout for the next heartbeat, which is sent every half second."""
    shutdown_s: float = 20.0
    """Timeout for a service to end after SIGTERM."""
    min_restart_delay_s: float = 1.0
    """Delay before the first restart after a crash. It doubles with each further crash."""
    max_restart_delay_s: float = 30.0
    """Maximum delay before a restart."""
    stable_after_s: float = 60.0
    """Run time after which the delay is reset to its minimum."""


def supervise(
    arguments: Sequence[str], command: Sequence[str] = SERVE, timeouts: SupervisorTimeouts | None = None
) -> int:
    """Run the service, and start it again after a crash, until it shuts down cleanly or by a signal.

    SIGINT and SIGTERM are forwarded to the service as SIGTERM. A service that ends before it listens for the first time
    is not started again: it has logged the reason.

    Args:
        arguments: Arguments for the command.
        command: Command that starts the service.
        timeouts: Timeouts and delays. None: the defaults.

    Returns:
        The exit code.
    """
    return _Supervisor(list(command), list(arguments), timeouts or SupervisorTimeouts()).run()


class _Supervisor:
    def __init__(self, command: list[str], arguments: list[str], timeouts: SupervisorTimeouts) -> None:
        self._command, self._arguments, self._timeouts = command, arguments, timeouts
        self._port: str | None = None
        """Port of the first service. Each restarted service must be reachable there."""
        self._child: subprocess.Popen[bytes] | None = None
        self._shutdown_requested_s: float | None = None

    def run(self) -> int:
        with _handle_signals(self._forward_signal):
            delay_s = self._timeouts.min_restart_delay_s
            while True:
                begin = time.monotonic()
                code, reason = self._run_service()
                if code == 0 or self._shutdown_requested_s is not None:
                    return max(0, code)
                if self._port is None:
                    return code if code > 0 else 1
                if time.monotonic() - begin > self._timeouts.stable_after_s:
                    delay_s = self._timeouts.min_restart_delay_s
                log.error("%s; it is started again in %g s", reason, delay_s)
                if not self._sleep(delay_s):
                    return 0
                delay_s = min(2 * delay_s, self._timeouts.max_restart_delay_s)

    def _run_service(self) -> tuple[int, str]:
        """Run the service once; return its exit code and a description of its end."""
        ours, theirs = socket.socketpair()
        with ours:
            with theirs:
                arguments = [*self._arguments, "--supervised", str(theirs.fileno())]
                if self._port is not None:
                    arguments += ["--port", self._port]  # overrides an earlier --port
                # The service has its own session, because Ctrl-C at a terminal would otherwise reach it twice.
                self._child = subprocess.Popen(
                    [*self._command, *arguments], pass_fds=[theirs.fileno()], start_new_session=True
                )
            if self._shutdown_requested_s is not None:  # the signal came before there was a child
                self._child.terminate()
            silent_s = self._monitor(ours, self._child)
            code = self._child.wait()
        if silent_s is not None:
            return code, f"the service sent no heartbeat for {silent_s:.0f} s and was killed"
        return code, f"the service ended unexpectedly ({_describe_exit(code)})"

    def _monitor(self, ours: socket.socket, child: subprocess.Popen[bytes]) -> float | None:
        """Read the heartbeats until the child has ended; kill it if it is silent, and return for how long it was."""
        last_heard_s, rest, timeout_s = time.monotonic(), b"", self._timeouts.start_s
        ours.setblocking(False)
        with selectors.DefaultSelector() as selector:
            selector.register(ours, selectors.EVENT_READ)
            ended = False
            while not ended:
                ended = child.poll() is not None  # its last messages are still read below
                if selector.select(0.0 if ended else 0.2):
                    with contextlib.suppress(ConnectionResetError):
                        received = ours.recv(4096)
                        if not received:  # the child has ended, or is about to end
                            with contextlib.suppress(subprocess.TimeoutExpired):
                                child.wait(0.2)
                        else:
                            last_heard_s, timeout_s = time.monotonic(), self._timeouts.heartbeat_s
                            *lines, rest = (rest + received).split(b"\n")
                            self._handle_messages(lines)
                silent_s = time.monotonic() - last_heard_s
                requested_s = self._shutdown_requested_s
                shutdown_s = 0.0 if requested_s is None else time.monotonic() - requested_s
                if silent_s > timeout_s or shutdown_s > self._timeouts.shutdown_s:
                    child.kill()
                    child.wait()
                    return silent_s
        return None

    def _handle_messages(self, lines: list[bytes]) -> None:
        for line in lines:
            kind, _, value = line.decode(errors="replace").partition(" ")
            if kind == "listening":
                self._port = value

    def _forward_signal(self, number: int, frame: FrameType | None) -> None:
        if self._shutdown_requested_s is None:
            self._shutdown_requested_s = time.monotonic()
        if self._child is not None and self._child.poll() is None:
            self._child.send_signal(signal.SIGTERM)

    def _sleep(self, delay_s: float) -> bool:
        """Sleep; return False if a signal requested the shutdown meanwhile."""
        end = time.monotonic() + delay_s
        while time.monotonic() < end and self._shutdown_requested_s is None:
            time.sleep(0.05)
        return self._shutdown_requested_s is None


@contextlib.contextmanager
def _handle_signals(handler: Callable[[int, FrameType | None], None]) -> Iterator[None]:
    """Handle SIGINT and SIGTERM by `handler`, even if the parent has blocked or ignored them."""
    numbers = (signal.SIGINT, signal.SIGTERM)
    previous = {number: signal.signal(number, handler) for number in numbers}
    signal.pthread_sigmask(signal.SIG_UNBLOCK, numbers)
    try:
        yield
    finally:
        for number, earlier in previous.items():
            signal.signal(number, earlier)


def _describe_exit(code: int) -> str:
    return f"exit code {code}" if code >= 0 else signal.Signals(-code).name
