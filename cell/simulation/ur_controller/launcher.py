"""Start and end of the virtual controller as a child process."""

import json
import os
import select
import subprocess
import time
from typing import TYPE_CHECKING, Self

import numpy as np
from numpy.typing import ArrayLike

from cell.process.python_process import end_process, start_python
from cell.simulation.ur_controller.admin_client import AdminClient

if TYPE_CHECKING:
    from cell.config.arm_models import ArmModelName

START_S = 60.0
"""Timeout of the start. Python and numpy take seconds on a busy machine."""
END_S = 2.0
"""Time for a controller to end after SIGTERM before it is killed."""


class ControllerStartError(RuntimeError):
    """The virtual controller could not be started, because its address is in use or the process died."""

    slug = "simulation"


class RunningController:
    """The process of a virtual controller. It ends with `close`, or with its parent process."""

    def __init__(self, process: "subprocess.Popen[bytes]", host: str) -> None:
        self._process = process
        self.host = host
        """Address of the controller."""
        self.admin = AdminClient(host)
        """Client for state, log and faults."""

    @property
    def pid(self) -> int:
        """Process id."""
        return self._process.pid

    @property
    def alive(self) -> bool:
        """Whether the process runs."""
        return self._process.poll() is None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """End the process. No zombie process and no open port remain."""
        self.admin.close()
        end_process(self._process, END_S, terminate=True)


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
    """Start a virtual controller, and return when it accepts connections.

    Args:
        model: Model of the arm.
        host: Loopback address. None means the first free one from 127.0.0.2 on.
        time_factor: Factor on the speed of the arm. Streams, watchdog and waits keep to the clock.
        q_rad: Joint angles (6,) at the start. None means the default posture.
        table_z_m: Height of a safety plane below which the flange must not go. None means no plane.
        software: Software version that the controller reports, for example "5.25.1".
        pose_error: Root mean squares of the reported pose's smooth error, metres and radians.
        seed: Seed of that error.

    Raises:
        ControllerStartError: The address is in use, or the process did not start.
    """
    if host is not None and not host.startswith("127."):
        raise ControllerStartError(f"{host} is not an address of this machine's loopback; give one like 127.0.0.2")
    command = ["-m", "cell.simulation.ur_controller", "--with-parent", "--model", model]
    command += [f"--time-factor={time_factor!r}"]
    command += [f"--host={host}"] if host is not None else []
    command += [f"--table-z-m={table_z_m!r}"] if table_z_m is not None else []
    command += [f"--software={software}"] if software is not None else []
    command += [f"--pose-error-m={pose_error[0]!r}", f"--pose-error-rad={pose_error[1]!r}", f"--seed={seed}"]
    command += (
        ["--q-rad", *map(repr, np.asarray(q_rad, dtype=np.float64).reshape(6).tolist())] if q_rad is not None else []
    )
    process = start_python(*command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    try:
        return RunningController(process, _host(process, host))
    except BaseException:
        end_process(process, END_S, terminate=True)
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
