"""A device's driver in a child process.

Vendor libraries hold the interpreter's lock, hang, and crash. In a child process they can do so without harm to the
service, the stop button or the other device. The child is killed, and the caller may start a new one.

A driver is any class. Its methods are called by name, one at a time, and its CellErrors are passed on to the caller. If
a driver has a method `idle` and a number `IDLE_S`, `idle(quiet_s)` is called after each period without a call, with the
time since the last call.
"""

import contextlib
import logging
import os
import pickle
import signal
import socket
import struct
import subprocess
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from typing import Any

from cell.errors import CellError
from cell.process.logging import child_logging_setup
from cell.process.python_process import end_process, exit_with_parent, start_python

log = logging.getLogger(__name__)

END_S = 1.0
"""Time for a child to end by itself before it is killed."""

HALF_S = 2
"""Longest pause within an answer before the child counts as hanging."""
STEP_S = 0.05
"""Step in which an answer is waited for."""
LATE = 0.25
"""Share of a timeout from which a late computer is named."""
LAST_WORDS_S = 0.05
"""Time for a process that has closed its pipe to end with an exit code before it is killed."""


class ChildLostError(Exception):
    """The process died, hung, or was killed. The message says which."""


class ChildBusyError(Exception):
    """The call of another thread did not end within the time to wait for the turn."""


class NotCalledError(Exception):
    """The call was cancelled before its turn, and nothing was sent."""


@dataclass(frozen=True)
class _Call:
    method: str
    arguments: tuple[Any, ...]


class Child:
    """One process with one driver. Every method may be called from any thread."""

    def __init__(self, name: str, make_driver: Callable[..., Any], *arguments: Any) -> None:
        """Start the process. It makes its driver by `make_driver(*arguments)` at the first call.

        Args:
            name: Name of the process in messages and in the log.
            make_driver: Class or function that makes the driver. It must be picklable, so not defined in a script.
            *arguments: Arguments of `make_driver`, which must be picklable.
        """
        first = pickle.dumps((child_logging_setup(), name, make_driver, arguments))
        self.name = name
        self._turn = threading.Lock()
        self._pipe, theirs = Pipe()
        _limit_pauses(self._pipe)
        # multiprocessing would first import the main program in the child, with all its imports
        with theirs:
            program = f"from cell.process.child import serve; serve({theirs.fileno()})"
            self._process = start_python("-c", program, stdin=subprocess.PIPE, pass_fds=[theirs.fileno()])
        with contextlib.suppress(OSError):  # the process may have died already, which the first call reports
            self._pipe.send_bytes(first)

    @property
    def pid(self) -> int:
        """Process id."""
        return self._process.pid

    @property
    def alive(self) -> bool:
        """Whether the process runs. It may hang nevertheless."""
        return self._process.poll() is None

    def call(
        self,
        method: str,
        *arguments: Any,
        timeout_s: float,
        turn_s: float | None = None,
        unless: threading.Event | None = None,
    ) -> Any:
        """Call a method of the driver and return its result.

        Args:
            method: Name of the method.
            *arguments: Arguments of the method, which must be picklable.
            timeout_s: Timeout of the answer. A child that does not answer in time is killed.
            turn_s: Longest time to wait for the call of another thread. None waits without limit.
            unless: Event that cancels the call. It is checked when no other call can come in between.

        Raises:
            NotCalledError: `unless` was set.
            ChildLostError: The process died or was killed, now or before.
            ChildBusyError: The call of another thread took longer than `turn_s`.
            CellError: The error of the driver.
        """
        if not self._turn.acquire(timeout=-1 if turn_s is None else turn_s):
            raise ChildBusyError(f"the {self.name} process is busy")
        try:
            if unless is not None and unless.is_set():
                raise NotCalledError(f"{method!r} of the {self.name} process was cancelled")
            return self._exchange(_Call(method, arguments), timeout_s)
        finally:
            self._turn.release()

    def kill(self) -> None:
        """Kill the process. A running call raises ChildLostError."""
        self._process.kill()

    def close(self) -> None:
        """End the process, after `close` of a driver that still answers. No zombie process remains."""
        if self.alive:
            with contextlib.suppress(ChildLostError, ChildBusyError, CellError):
                self.call("close", timeout_s=END_S, turn_s=END_S)
        end_process(self._process)
        with self._turn:
            self._pipe.close()

    def _exchange(self, call: _Call, timeout_s: float) -> Any:
        try:
            begin_s = time.monotonic()
            self._pipe.send(call)
            answered, late_s = _wait(self._pipe, timeout_s, begin_s)
            if not answered:
                end_process(self._process)
                late = f"; this computer was {late_s:.1f} s late meanwhile"
                raise ChildLostError(
                    f"the {self.name} process did not answer {call.method!r} within {timeout_s:g} s"
                    f"{late if late_s >= LATE * timeout_s else ''}"
                )
            answer = self._pipe.recv()
        except BlockingIOError as error:
            end_process(self._process)
            raise ChildLostError(
                f"the {self.name} process closed the connection during its answer to {call.method!r}"
            ) from error
        except (EOFError, OSError) as error:
            code = end_process(self._process, LAST_WORDS_S)
            raise ChildLostError(f"the {self.name} process has ended (exit code {code})") from error
        except BaseException:
            self.kill()  # interrupted: the answer must not be taken for that of the next call
            raise
        if isinstance(answer, Exception):
            raise answer
        return answer


def _wait(pipe: Connection, timeout_s: float, begin_s: float) -> tuple[bool, float]:
    """Wait for an answer to a call that began at `begin_s`. Return whether there is one, and how late this process was.

    It waits in steps. A process that takes longer for one was not given the processor.
    """
    now_s = time.monotonic()
    end_s, late_s = now_s + timeout_s, now_s - begin_s
    while True:
        step_s = min(STEP_S, max(end_s - now_s, 0.0))
        answered = pipe.poll(step_s)
        before_s, now_s = now_s, time.monotonic()
        late_s += max(now_s - before_s - step_s, 0.0)
        if answered or now_s >= end_s:
            return answered, late_s


def _limit_pauses(pipe: Connection) -> None:
    """Set the timeout within an answer, for example of a large image. The first byte has its own timeout."""
    with socket.socket(fileno=os.dup(pipe.fileno())) as end:
        end.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, struct.pack("ll", HALF_S, 0))


def serve(pipe_number: int) -> None:
    """Run the loop of the child over the inherited pipe."""
    # the parent ends the child, although a service manager's SIGTERM reaches the child too
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, signal.SIG_IGN)
    os.dup2(2, 1)  # vendor libraries print, and stdout is for our own output
    exit_with_parent()  # so that no process keeps a device
    made: list[Any] = []
    with contextlib.suppress(EOFError, OSError), Connection(pipe_number) as pipe:
        set_up_log, name, make_driver, arguments = pickle.loads(pipe.recv_bytes())
        if set_up_log is not None:
            set_up_log(name)
        _answer_calls(pipe, make_driver, arguments, made)
    # A driver that was not closed is not destroyed: the destructor of a vendor library may wait for a thread that waits
    # for Python.
    os._exit(0)


def _answer_calls(
    pipe: Connection, make_driver: Callable[..., Any], arguments: tuple[Any, ...], made: list[Any]
) -> None:
    """Answer the calls of the parent. The driver is appended to `made`."""
    last_call_s = time.monotonic()
    while True:
        # an error in `idle` ends the process, which the parent notices
        while made and hasattr(made[0], "idle") and not pipe.poll(made[0].IDLE_S):
            made[0].idle(time.monotonic() - last_call_s)
        call: _Call = pipe.recv()
        if call.method == "close" and not made:
            pipe.send(None)  # no driver is made only to be closed
            return
        last_call_s = time.monotonic()
        try:
            if not made:
                made.append(make_driver(*arguments))
            answer = getattr(made[0], call.method)(*call.arguments)
        except CellError as error:
            answer = error
        except Exception as error:  # a fault of the driver, whose traceback is in the log
            log.exception("%s failed", call.method)
            answer = CellError(f"{call.method} raised an unexpected {type(error).__name__}: {error}; please report it")
        pipe.send(answer)
