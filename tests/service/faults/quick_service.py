"""Services that start fast, for tests that kill hundreds of them.

The program loads all modules once. For each line `DATA_DIR RETENTION HOST` on stdin it forks a service and prints
`PID PORT`. One service runs at a time; the test kills it before it sends the next line.
"""

import os
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import timedelta
from pathlib import Path

ROOT = Path(__file__).resolve().parents[3]
PROGRAM = "import sys; from tests.service.faults.quick_service import main; main(sys.argv[1])"


@dataclass(frozen=True)
class RunningService:
    """A running service."""

    pid: int
    port: int


class QuickServices:
    """Starts services through the program."""

    def __init__(self, program: subprocess.Popen[str]) -> None:
        self._program = program

    def start(self, data: Path, *, retention: bool = False, host: str = "-") -> RunningService:
        """Start a service. `host` is the address of the simulated controller; `-` means no controller."""
        assert self._program.stdin is not None
        assert self._program.stdout is not None
        self._program.stdin.write(f"{data} {int(retention)} {host}\n")
        self._program.stdin.flush()
        pid, port = self._program.stdout.readline().split()
        return RunningService(int(pid), int(port))


@contextmanager
def quick_services(recording: Path, log: Path) -> Iterator[QuickServices]:
    """Run the program during the body. Its services write their output to `log`."""
    with (
        log.open("wb") as output,
        subprocess.Popen(
            [sys.executable, "-c", PROGRAM, str(recording)],
            cwd=ROOT,
            text=True,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=output,
        ) as program,
    ):
        try:
            yield QuickServices(program)
        finally:
            program.kill()


def main(recording: str) -> None:
    """Run the program."""
    import service.api.routes.recordings
    import service.app
    import service.jobs.manager
    import service.storage.retention
    from tests.service.faults.recognition_stub import describe_here, stub_factory

    service.jobs.manager.RecognitionWorker = stub_factory(Path(recording))  # type: ignore[misc,assignment]
    service.api.routes.recordings.describe_untrusted_recording = describe_here
    service.storage.retention.STEADY_S, service.storage.retention.INTERVAL_S = 0.0, 0.05
    service.storage.retention.MIN_AGE = timedelta(seconds=3)
    for line in sys.stdin:
        data, retention, host = line.split()
        listening = socket.create_server(("127.0.0.1", 0))
        pid = os.fork()
        if pid == 0:
            try:
                _serve(Path(data), retention == "1", host, listening)
            finally:
                os._exit(1)
        print(pid, listening.getsockname()[1], flush=True)
        listening.close()
        os.waitpid(pid, 0)


def _serve(data: Path, retention: bool, host: str, listening: socket.socket) -> None:
    from cell.config.arm_config import SimulatedArm
    from cell.config.camera_config import SimulatedCamera
    from service.app import create_app
    from service.config.loader import ServiceConfig
    from service.server.uvicorn_server import Server

    settings = {
        "data_dir": data,
        "retention": {"max_bytes": 2 << 20} if retention else {},
        "camera": SimulatedCamera(model="exact", fps=30.0, exposures=1, settle_s=0.0),
    }
    if host != "-":
        settings["arm"] = SimulatedArm(host=host, time_factor=20.0, watchdog_hz=1.0)
    app = create_app(ServiceConfig(**settings))  # type: ignore[arg-type] (sections of several types)
    Server(app, log_level="warning", access_log=False).run(sockets=[listening])
