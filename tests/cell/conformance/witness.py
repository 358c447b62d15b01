"""Record the RTDE data of a controller by a client that uses neither our driver nor ur_rtde."""

import threading
import time
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from tests.cell.simulation.ur_controller.rtde_client import RtdeClient

STILL_RAD_S = 0.005
NAMES = ("timestamp", "actual_q", "actual_qd", "runtime_state")
STOPPED = 1
"""Runtime state without a program."""


class Witness:
    """Recorder of all data of a controller, 125 samples per second."""

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
        """Present joint angles (6,)."""
        return np.array(self._samples[-1]["actual_q"])

    @property
    def moving(self) -> bool:
        """Whether the joints turn."""
        return bool(np.abs(self._samples[-1]["actual_qd"]).max() > STILL_RAD_S)

    @property
    def program(self) -> bool:
        """Whether the controller has a program."""
        return self._samples[-1]["runtime_state"] != STOPPED

    @property
    def count(self) -> int:
        """Number of samples, which is the index of the next one."""
        return len(self._samples)

    def since(self, count: int) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Return the controller times (N,), joint angles (N, 6) and speeds (N, 6) from the sample `count` on."""
        samples = self._samples[count:]
        clock, q, qd = (np.array([sample[name] for sample in samples]) for name in NAMES[:3])
        return clock, q, qd

    def wait_until(self, moving: bool, timeout_s: float = 10.0) -> None:
        """Wait until the arm moves, or until it is at rest."""
        limit_s = time.monotonic() + timeout_s
        while self.moving is not moving:
            assert time.monotonic() < limit_s, f"the arm did not {'begin to move' if moving else 'come to rest'}"
            time.sleep(0.005)

    def _watch(self) -> None:
        try:
            while True:
                self._samples.append(self._client.data())
        except OSError:  # includes ConnectionError
            return
