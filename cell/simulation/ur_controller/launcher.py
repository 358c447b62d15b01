"""Starts the virtual controller in a process of its own and ends it again."""

import json
import os
import select
import subprocess
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Self

import numpy as np
from numpy.typing import ArrayLike

from cell.simulation.ur_controller.admin_client import AdminClient

if TYPE_CHECKING:
    from cell.config.arm_config import ArmModelName

START_S = 60.0
"""A loaded machine takes seconds to start Python and numpy."""
END_S = 2.0


class ControllerStartError(RuntimeError):
    """The virtual controller could not be started: its address is taken, or the process died."""

    slug = "simulation"


class RunningController:
    """A virtual controller's process. It ends with `close`, or with the process that started it."""

    def __init__(self, process: "subprocess.Popen[bytes]", host: str) -> None:
        self._process = process
        self.host = host
        """The address that it listens on."""
        self.admin = AdminClient(host)
        """Its state, its log, and faults."""

    @property
    def pid(self) -> int:
        """The process's id."""
        return self._process.pid

    @property
    def alive(self) -> bool:
        """The process runs."""
        return self._process.poll() is None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Ends the process. Leaves neither a zombie nor an open port behind."""
        self.admin.close()
        _end(self._process)


def start_controller(
    model: "ArmModelName" = "ur5e",
    host: str | None = None,
    time_factor: float = 1.0,
    q_rad: ArrayLike | None = None,
    table_z_m: float | None = None,
    software: str | None = None,
    pose_error: tuple[float, float] = (0.0, 0.0),
    seed: int = 0,
) -> RunningController:
    """Starts a virtual controller and returns when it takes connections.

    Args:
        model: which arm it has.
        host: loopback address; the first free one from 127.0.0.2 on unless given.
        time_factor: the arm moves so many times as fast; stream, watchdog and waits keep to the clock.
        q_rad: (6,) joint angles at the start.
        table_z_m: height of a safety plane that the flange must not come below; None for none.
        software: the version that it tells, as "5.25.1".
        pose_error: Root mean squares of the reported pose's smooth error, metres and radians.
        seed: Seed of that error.

    Raises:
        ControllerStartError: the address is taken, or the process did not start.
    """
    if host is not None and not host.startswith("127."):
        raise ControllerStartError(f"{host} is not an address of this machine's loopback; give one like 127.0.0.2")
    command = [sys.executable, "-m", "cell.simulation.ur_controller", "--with-parent", "--model", model]
    command += [f"--time-factor={time_factor!r}"]
    command += [f"--host={host}"] if host is not None else []
    command += [f"--table-z-m={table_z_m!r}"] if table_z_m is not None else []
    command += [f"--software={software}"] if software is not None else []
    command += [f"--pose-error-m={pose_error[0]!r}", f"--pose-error-rad={pose_error[1]!r}", f"--seed={seed}"]
    command += (
        ["--q-rad", *map(repr, np.asarray(q_rad, dtype=np.float64).reshape(6).tolist())] if q_rad is not None else []
    )
    # The package is found from wherever this process was started; a stop of our terminal does not stop the robot.
    root = str(Path(__file__).resolve().parents[3])
    paths = [root, *filter(None, [os.environ.get("PYTHONPATH")])]
    process = subprocess.Popen(
        command,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(paths)},
        start_new_session=True,
    )
    try:
        return RunningController(process, _host(process, host))
    except BaseException:
        _end(process)
        raise


def _host(process: "subprocess.Popen[bytes]", host: str | None) -> str:
    assert process.stdout is not None
    deadline_s, line = time.monotonic() + START_S, b""
    while not line.endswith(b"\n"):
        left_s = max(0.0, deadline_s - time.monotonic())
        if not select.select([process.stdout], [], [], left_s)[0]:
            raise ControllerStartError(f"the virtual controller did not start within {START_S:g} s")
        part = os.read(process.stdout.fileno(), 4096)
        if not part:
            raise ControllerStartError(f"the virtual controller ended at its start (exit code {process.wait(END_S)})")
        line += part
    answer = json.loads(line)
    if "error" in answer:
        hint = "end what listens there, or choose another address" if host else "end some of them"
        raise ControllerStartError(f"{answer['error']}; {hint}")
    return answer["host"]


def _end(process: "subprocess.Popen[bytes]") -> None:
    for stream in (process.stdin, process.stdout):
        if stream is not None:
            stream.close()
    process.terminate()
    try:
        process.wait(END_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
