"""A device's driver in a process of its own.

Vendor libraries hold the interpreter's lock, hang, and crash. In a child process they can do so without taking the
service, the stop button or the other device with them: the child is killed, and a new one made by whoever decides to
connect again. A driver is any class; its methods are called by name, one at a time, and its CellErrors come back as
they are. A driver with a method `idle` and a number `IDLE_S` has `idle(quiet_s)` called after every so many seconds
without a call, with how long ago the last one was.
"""

import contextlib
import logging
import os
import pickle
import signal
import socket
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from cell.errors import CellError
from cell.process.logging import child_set_up

log = logging.getLogger(__name__)

END_S = 1.0
"""How long a child may take to end by itself before it is killed."""

HALF_S = 2
"""An answer that has begun may pause for so long before the child counts as hanging."""
LAST_WORDS_S = 0.05
"""A process that has closed its pipe may take so long to end, and to say how, before it is killed."""


class ChildLostError(Exception):
    """The process died, hung, or was killed; the message says which."""


class ChildBusyError(Exception):
    """Another thread's call did not end in the time that this one had to wait for its turn."""


class NotCalledError(Exception):
    """When its turn had come, the call was no longer wanted: nothing was sent."""


@dataclass(frozen=True)
class _Call:
    method: str
    arguments: tuple[Any, ...]


class Child:
    """One process with one driver. Safe to use from any thread."""

    def __init__(self, name: str, make_driver: Callable[..., Any], *arguments: Any) -> None:
        """Starts the process; it makes its driver by `make_driver(*arguments)` at the first call.

        `make_driver` is named to the child by its module, and so cannot be one of a script.
        """
        first = pickle.dumps((child_set_up(), name, make_driver, arguments))
        self.name = name
        self._turn = threading.Lock()
        self._pipe, theirs = Pipe()
        _limit_pauses(self._pipe)
        # Not a process of multiprocessing: that would first import the program that runs here, with all that it needs.
        with theirs:
            self._process = subprocess.Popen(
                [sys.executable, "-P", "-c", f"from cell.process.child import serve; serve({theirs.fileno()})"],
                stdin=subprocess.PIPE,  # held open; the child ends when it closes, however this process ends
                pass_fds=[theirs.fileno()],
                env={**os.environ, "PYTHONPATH": os.pathsep.join(path or str(Path.cwd()) for path in sys.path)},
                start_new_session=True,
            )
        with contextlib.suppress(OSError):  # it has died at once: the first call tells
            self._pipe.send_bytes(first)

    @property
    def pid(self) -> int:
        """The process's id."""
        return self._process.pid

    @property
    def alive(self) -> bool:
        """The process runs. It may hang all the same."""
        return self._process.poll() is None

    def call(
        self,
        method: str,
        *arguments: Any,
        timeout_s: float,
        turn_s: float | None = None,
        unless: threading.Event | None = None,
    ) -> Any:
        """What the driver's method returns. A child that does not answer within `timeout_s` is killed.

        `unless`: looked at when the turn has come, and as long as no other call can come in between.

        Raises:
            NotCalledError: `unless` was set.
            ChildLostError: the process died or was killed, now or before.
            ChildBusyError: another thread's call took longer than `turn_s` (for as long as it takes unless given).
            CellError: what the driver raised.
        """
        if not self._turn.acquire(timeout=-1 if turn_s is None else turn_s):
            raise ChildBusyError(f"the {self.name} process is busy")
        try:
            if unless is not None and unless.is_set():
                raise NotCalledError(f"{method!r} of the {self.name} process is no longer wanted")
            return self._exchange(_Call(method, arguments), timeout_s)
        finally:
            self._turn.release()

    def kill(self) -> None:
        """Ends the process at once, whatever it does; a call under way raises ChildLostError."""
        self._process.kill()

    def close(self) -> None:
        """Ends the process: a driver that was made and still answers has `close` called. Leaves no zombie behind."""
        if self.alive:
            with contextlib.suppress(ChildLostError, ChildBusyError, CellError):
                self.call("close", timeout_s=END_S, turn_s=END_S)
        self._end()
        with self._turn:
            self._pipe.close()

    def _exchange(self, call: _Call, timeout_s: float) -> Any:
        try:
            self._pipe.send(call)
            if not self._pipe.poll(timeout_s):
                self._end()
                raise ChildLostError(f"the {self.name} process did not answer {call.method!r} within {timeout_s:g} s")
            answer = self._pipe.recv()
        except BlockingIOError as error:
            self._end()
            raise ChildLostError(f"the {self.name} process stopped amid its answer to {call.method!r}") from error
        except (EOFError, OSError) as error:
            code = self._end(LAST_WORDS_S)
            raise ChildLostError(f"the {self.name} process has ended (exit code {code})") from error
        except BaseException:
            self.kill()  # interrupted: its answer must not be taken for that of the next call
            raise
        if isinstance(answer, Exception):
            raise answer
        return answer

    def _end(self, wait_s: float = 0.0) -> int:
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(wait_s)
        self.kill()
        code = self._process.wait()
        assert self._process.stdin is not None
        self._process.stdin.close()
        return code


def _limit_pauses(pipe: Connection) -> None:
    """Waiting for the first byte of an answer has its own limit; this is for the rest, as of a large image."""
    with socket.socket(fileno=os.dup(pipe.fileno())) as end:
        end.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, struct.pack("ll", HALF_S, 0))


def serve(pipe_number: int) -> None:
    """The child's own loop, over the inherited pipe."""
    # A service manager's SIGTERM reaches it too; the parent ends it in its own time.
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, signal.SIG_IGN)
    os.dup2(2, 1)  # vendor libraries print; stdout is for our own output
    threading.Thread(target=_end_with_parent, daemon=True).start()
    made: list[Any] = []
    with contextlib.suppress(EOFError, OSError), Connection(pipe_number) as pipe:
        set_up_log, name, make_driver, arguments = pickle.loads(pipe.recv_bytes())
        if set_up_log is not None:
            set_up_log(name)
        _answer_calls(pipe, make_driver, arguments, made)
    # A driver that nobody has closed is not taken apart: a vendor library's destructor may wait for a thread that in
    # turn waits for Python.
    os._exit(0)


def _answer_calls(
    pipe: Connection, make_driver: Callable[..., Any], arguments: tuple[Any, ...], made: list[Any]
) -> None:
    """`made`: takes the driver, once there is one."""
    last_call_s = time.monotonic()
    while True:
        # An error in `idle` ends the process: nobody waits for its answer, and the end is what the parent notices.
        while made and hasattr(made[0], "idle") and not pipe.poll(made[0].IDLE_S):
            made[0].idle(time.monotonic() - last_call_s)
        call: _Call = pipe.recv()
        if call.method == "close" and not made:
            pipe.send(None)  # a driver is not made, and its device not opened, only to be closed
            return
        last_call_s = time.monotonic()
        try:
            if not made:
                made.append(make_driver(*arguments))
            answer = getattr(made[0], call.method)(*call.arguments)
        except CellError as error:
            answer = error
        except Exception as error:  # a fault of the driver: the parent is told, and the log has where
            log.exception("%s failed", call.method)
            answer = CellError(f"{call.method} met an unexpected {type(error).__name__}: {error}; please report it")
        pipe.send(answer)


def _end_with_parent() -> None:
    """A killed parent leaves no process behind that holds a device."""
    while os.read(0, 1024):
        pass
    os._exit(1)
