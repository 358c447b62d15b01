"""A service with a simulated cell that goes on over restarts, and all that can happen to it from outside."""

import os
import signal
import sqlite3
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import httpx2

from cell.config.arm_config import SimulatedArm
from cell.config.camera_config import SimulatedCamera
from cell.errors import CellError
from cell.simulation.ur_controller.admin_client import AdminClient, ControllerGoneError
from service.config.sections import RetentionConfig
from service.storage.data_folder import DATABASE
from service.storage.retention import sweep
from tests.cell.loopback import free_host
from tests.service.conftest import Serve, ServedClient, wait_until
from tests.service.described_answers import check_described, slug
from tests.service.live_cell import FAST
from tests.service.state_machine.journal import Journal
from tests.service.state_machine.motion import Leases

LOCKED_S = 0.3


class World:
    """The service, its controller, and what they have said so far."""

    def __init__(self, serve: Serve, data: Path) -> None:
        self._serve, self._data = serve, data
        self._opened = ExitStack()
        self.journal, self.leases = Journal(data), Leases()
        self.client: ServedClient
        self.steps = 0
        """Taken so far."""
        self.start()

    def start(self) -> None:
        """Starts a service on the data folder."""
        host = free_host()
        # A watchdog of 1 Hz: a busy machine may keep a thread of ours waiting for longer than the default one does.
        arm = SimulatedArm(host=host, time_factor=50.0, watchdog_hz=1.0)
        camera = SimulatedCamera(model="ideal", **FAST)
        self.leases.states.append((time.monotonic(), "not_ready"))
        self.client = self._opened.enter_context(
            self._serve(self._data, arm=arm, camera=camera, scan={"views": 3, "min_views": 2})
        )
        self.controller = AdminClient(host)
        self._opened.callback(self.controller.close)
        self._opened.callback(self.check_motion)
        self._motions_seen = 0
        self.client.app.state.context.cell.on_status(
            lambda status: self.leases.states.append((time.monotonic(), status.state))
        )

    def stop(self) -> None:
        """Ends the service in order."""
        self._opened.close()

    def call(self, method: str, path: str, **options: Any) -> httpx2.Response:
        """An answer, which is as described."""
        answer = self.client.request(method, path, **options)
        check_described(answer)
        return answer

    @property
    def state(self) -> str:
        """Of the cell."""
        return self.client.app.state.context.cell.status.state

    def start_scan(self, body: dict[str, Any], key: str | None) -> httpx2.Response:
        """Asks for a scan; one by the cell may move from then on."""
        asked = time.monotonic()
        answer = self.call("POST", "/api/scans", json=body, headers={} if key is None else {"Idempotency-Key": key})
        if answer.status_code == 202 and body["mode"] == "live":
            self.leases.asked.append(asked)
        return answer

    def stop_arm(self) -> None:
        """Nothing may move from then on, and nothing can refuse it."""
        assert self.call("POST", "/api/cell/stop").status_code == 200
        self.leases.stopped.append(time.monotonic())

    def cancel(self, scan: str) -> None:
        """The same for a scan by the cell that was under way."""
        self.journal.look()
        live = scan in self.journal.active and self.journal.scans[scan]["mode"] == "live"
        answer = self.call("POST", f"/api/scans/{scan}/cancel")
        assert slug(answer) in (None, "not-cancellable")
        if live and answer.status_code == 200 and answer.json()["state"] in ("stopping", "aborted"):
            self.leases.stopped.append(time.monotonic())

    def check_motion(self) -> None:
        """Each motion that the controller has noted since the last time had a lease."""
        with suppress(ControllerGoneError):  # not started yet: it comes with the first connection
            for event in self.controller.log(self._motions_seen):
                self._motions_seen = event["index"] + 1
                if event["kind"] == "motion_start":
                    self.leases.check(event["stamp_s"])

    def settle(self) -> None:
        """Waits until no scan is under way, and the arm is where it should be."""

        def at_rest() -> bool:
            self.journal.look()
            return not self.journal.active and self.state != "busy"

        wait_until(at_rest)

    def kill_recognition(self) -> None:
        """As when memory runs out."""
        with suppress(AssertionError, ProcessLookupError):  # it is just being started, or has ended
            os.kill(self.client.recognition_pid, signal.SIGKILL)

    def robot(self, fault: str) -> None:
        """Something happens to the robot; nothing, as long as there is none."""
        with suppress(ControllerGoneError):
            getattr(self.controller, fault)()

    def camera(self, fault: Any) -> None:
        """The camera begins to fail, or no longer does; nothing, as long as it is not connected."""
        with suppress(CellError):
            self.client.app.state.context.cell.camera.fault(fault)

    @contextmanager
    def locked(self) -> Iterator[None]:
        """The body runs while another program writes to the database, for a moment."""
        other = sqlite3.connect(self._data / DATABASE, timeout=10.0, check_same_thread=False)
        other.execute("BEGIN IMMEDIATE")
        unlock = threading.Timer(LOCKED_S, other.rollback)
        unlock.start()
        try:
            yield
        finally:
            unlock.join()
            other.close()

    def sweep(self, days: float) -> None:
        """Retention, some days later, with at most one day to keep things for."""
        context = self.client.app.state.context
        self.journal.look()
        sweep(context.store, RetentionConfig(max_age_days=1), datetime.now(UTC) + timedelta(days=days), lambda: True)
        self.journal.look(removing=True)
