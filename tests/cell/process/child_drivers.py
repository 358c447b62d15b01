"""Drivers for tests of `cell.process.child`, in a separate module so that the child imports only these."""

import os
import time
from pathlib import Path

from cell.arm.rtde_driver import UrDriver
from cell.errors import CellError, MotionError


class Driver:
    """Driver with the normal and faulty behaviour of vendor libraries."""

    IDLE_S = 0.02

    def __init__(self, offset: int = 0) -> None:
        self.offset = offset
        self.quiet: list[float] = []

    def add(self, a: int, b: int) -> int:
        return a + b + self.offset

    def refuse(self) -> None:
        raise MotionError("the robot refuses")

    def fail(self) -> None:
        raise KeyError("joint")

    def sleep(self, seconds: float) -> str:
        time.sleep(seconds)
        return "slept"

    def wait_for(self, path: Path) -> str:
        while not path.exists():
            time.sleep(0.001)
        return "waited"

    def hang(self, begun: Path) -> None:
        begun.touch()
        time.sleep(60.0)

    def picture(self) -> bytes:
        return bytes(5_000_000)

    def crash(self) -> None:
        os.abort()

    def chatter(self) -> None:
        os.write(1, b"vendor chatter\n")

    def idle(self, quiet_s: float) -> None:
        self.quiet.append(quiet_s)

    def quiet_times(self) -> list[float]:
        return self.quiet

    def close(self) -> None:
        pass


class BrokenWhenIdle(Driver):
    def idle(self, quiet_s: float) -> None:
        raise RuntimeError("the device is gone")


class Counted(Driver):
    """Driver that records each attempt to open its device, which may fail."""

    def __init__(self, attempts: Path, opens: bool) -> None:
        with attempts.open("a") as log:
            log.write("opened\n")
        if not opens:
            raise CellError("no device here")
        super().__init__()


class SlowToAllow(UrDriver):
    """Driver that returns the answer of the controller with a delay."""

    def allows(self, q_rad: tuple[float, ...]) -> bool:
        allowed = super().allows(q_rad)
        time.sleep(0.2)
        return allowed


def refusing() -> Driver:
    raise CellError("no device here")
