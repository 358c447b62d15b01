"""Keeps the service running: a process that does nothing else, so that little else can end it.

The service says over a socket where it listens, and that its event loop turns. One that dies is started again, one that
has gone silent is killed first. When the supervisor dies, the service ends in order: the socket closes. Nothing of the
arm is done here: a service that hangs stops it itself, and for one that is dead or suspended the controller does.
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

# Nothing is imported from the folder that somebody happens to be in.
SERVE = (
    sys.executable,
    "-P",
    "-c",
    "import sys; from service.cli.main import main; sys.exit(main(sys.argv[1:]))",
    "serve",
)


@dataclass(frozen=True)
class Patience:
    """How long is waited for what, seconds."""

    start_s: float = 60.0
    """For a service to listen."""
    silent_s: float = 10.0
    """For the next sign of life: it comes every half second."""
    end_s: float = 20.0
    """For a service that was told to end."""
    first_delay_s: float = 1.0
    """Before the first start after a crash; it doubles from one to the next ..."""
    longest_delay_s: float = 30.0
    """... up to this ..."""
    well_s: float = 60.0
    """... and begins anew behind a service that has run for so long."""


def supervise(arguments: Sequence[str], command: Sequence[str] = SERVE, patience: Patience | None = None) -> int:
    """Runs `command` with `arguments` until it ends in order, or SIGINT or SIGTERM is passed on to it; its exit code.

    One that ends before it listens for the first time is not started again: it has said why.
    """
    return _Supervisor(list(command), list(arguments), patience or Patience()).run()


class _Supervisor:
    def __init__(self, command: list[str], arguments: list[str], patience: Patience) -> None:
        self._command, self._arguments, self._patience = command, arguments, patience
        self._port: str | None = None
        """Where the first one listened: the next must be found there."""
        self._child: subprocess.Popen[bytes] | None = None
        self._told_to_end: float | None = None

    def run(self) -> int:
        with _handling(self._pass_on):
            delay_s = self._patience.first_delay_s
            while True:
                begin = time.monotonic()
                code, why = self._one()
                if code == 0 or self._told_to_end is not None:
                    return max(0, code)
                if self._port is None:
                    return code if code > 0 else 1
                if time.monotonic() - begin > self._patience.well_s:
                    delay_s = self._patience.first_delay_s
                log.error("%s; it is started again in %g s", why, delay_s)
                if not self._wait(delay_s):
                    return 0
                delay_s = min(2 * delay_s, self._patience.longest_delay_s)

    def _one(self) -> tuple[int, str]:
        """One life of the service: how it ended, as a code and in words."""
        ours, theirs = socket.socketpair()
        with ours:
            with theirs:
                arguments = [*self._arguments, "--supervised", str(theirs.fileno())]
                if self._port is not None:
                    arguments += ["--port", self._port]  # the last one counts
                # In a session of its own: Ctrl-C at a terminal would reach it twice.
                self._child = subprocess.Popen(
                    [*self._command, *arguments], pass_fds=[theirs.fileno()], start_new_session=True
                )
            if self._told_to_end is not None:  # the signal came when there was no child
                self._child.terminate()
            silent_s = self._listen(ours, self._child)
            code = self._child.wait()
        if silent_s is not None:
            return code, f"the service had not been heard from for {silent_s:.0f} s and was killed"
        return code, f"the service ended unexpectedly ({_in_words(code)})"

    def _listen(self, ours: socket.socket, child: subprocess.Popen[bytes]) -> float | None:
        """Until the child has ended; it is killed when it is silent: for how long it was, if so."""
        heard, rest, limit_s = time.monotonic(), b"", self._patience.start_s
        ours.setblocking(False)
        with selectors.DefaultSelector() as selector:
            selector.register(ours, selectors.EVENT_READ)
            ended = False
            while not ended:
                ended = child.poll() is not None  # what it has said before is still read
                if selector.select(0.0 if ended else 0.2):
                    with contextlib.suppress(ConnectionResetError):
                        received = ours.recv(4096)
                        if not received:  # it has ended, or is about to
                            with contextlib.suppress(subprocess.TimeoutExpired):
                                child.wait(0.2)
                        else:
                            heard, limit_s = time.monotonic(), self._patience.silent_s
                            *lines, rest = (rest + received).split(b"\n")
                            self._note(lines)
                silent_s = time.monotonic() - heard
                ending_s = 0.0 if self._told_to_end is None else time.monotonic() - self._told_to_end
                if silent_s > limit_s or ending_s > self._patience.end_s:
                    child.kill()
                    child.wait()
                    return silent_s
        return None

    def _note(self, lines: list[bytes]) -> None:
        for line in lines:
            word, _, value = line.decode(errors="replace").partition(" ")
            if word == "listening":
                self._port = value

    def _pass_on(self, number: int, frame: FrameType | None) -> None:
        if self._told_to_end is None:
            self._told_to_end = time.monotonic()
        if self._child is not None and self._child.poll() is None:
            self._child.send_signal(signal.SIGTERM)

    def _wait(self, delay_s: float) -> bool:
        """Whether it was waited for so long: not when told to end meanwhile."""
        end = time.monotonic() + delay_s
        while time.monotonic() < end and self._told_to_end is None:
            time.sleep(0.05)
        return self._told_to_end is None


@contextlib.contextmanager
def _handling(handler: Callable[[int, FrameType | None], None]) -> Iterator[None]:
    """The signals that end a program go to `handler`, also where the parent has blocked or ignored them."""
    numbers = (signal.SIGINT, signal.SIGTERM)
    before = {number: signal.signal(number, handler) for number in numbers}
    signal.pthread_sigmask(signal.SIG_UNBLOCK, numbers)
    try:
        yield
    finally:
        for number, earlier in before.items():
            signal.signal(number, earlier)


def _in_words(code: int) -> str:
    return f"exit code {code}" if code >= 0 else signal.Signals(-code).name
