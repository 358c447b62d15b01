"""What a controller tells of itself over RTDE, watched by a client that has nothing of ours or of ur_rtde in it."""

import threading
import time
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from tests.cell.simulation.ur_controller.rtde_client import RtdeClient

STILL_RAD_S = 0.005
NAMES = ("timestamp", "actual_q", "actual_qd", "runtime_state")
STOPPED = 1
"""The runtime state without a program."""


class Witness:
    """Keeps all that the controller sends, 125 times a second."""

    def __init__(self, host: str) -> None:
        self._client = RtdeClient(host)
        self._client.outputs(NAMES, hz=125.0)
        assert self._client.start()
        self._samples: list[dict[str, Any]] = [self._client.data()]
        self._thread = threading.Thread(target=self._watch, daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._client.socket.shutdown(2)
        self._thread.join(10.0)
        self._client.socket.close()

    @property
    def q_rad(self) -> NDArray[np.float64]:
        """(6,) the joint angles now."""
        return np.array(self._samples[-1]["actual_q"])

    @property
    def moving(self) -> bool:
        """The joints turn."""
        return bool(np.abs(self._samples[-1]["actual_qd"]).max() > STILL_RAD_S)

    @property
    def program(self) -> bool:
        """A program is there."""
        return self._samples[-1]["runtime_state"] != STOPPED

    @property
    def count(self) -> int:
        """How many samples there are: the place of the next one."""
        return len(self._samples)

    def since(self, count: int) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """The controller's clock (N,), joint angles (N, 6) and speeds (N, 6) of all samples from that one on."""
        samples = self._samples[count:]
        clock, q, qd = (np.array([sample[name] for sample in samples]) for name in NAMES[:3])
        return clock, q, qd

    def wait_until(self, moving: bool, timeout_s: float = 10.0) -> None:
        """Waits for the arm to move, or to be at rest."""
        limit_s = time.monotonic() + timeout_s
        while self.moving is not moving:
            assert time.monotonic() < limit_s, f"the arm did not {'begin to move' if moving else 'come to rest'}"
            time.sleep(0.005)

    def _watch(self) -> None:
        try:
            while True:
                self._samples.append(self._client.data())
        except OSError:  # ConnectionError is one
            return
