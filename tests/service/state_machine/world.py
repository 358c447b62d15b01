"""A service with a simulated cell that can be restarted, and the external events that can affect it."""

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
from tests.service.state_machine.motion import MotionCheck

LOCKED_S = 0.3
"""How long another program locks the database."""


class World:
    """The service, its controller, and the checked history of both."""

    def __init__(self, serve: Serve, data: Path) -> None:
        self._serve, self._data = serve, data
        self._opened = ExitStack()
        self.journal, self.motion = Journal(data), MotionCheck()
        self.client: ServedClient
        self.steps = 0
        """Steps taken."""
        self.start()

    def start(self) -> None:
        """Start a service on the data folder."""
        host = free_host()
        # On a busy machine, a thread may wait for longer than the default watchdog allows, so its rate is 1 Hz.
        arm = SimulatedArm(host=host, time_factor=50.0, watchdog_hz=1.0)
        camera = SimulatedCamera(model="exact", **FAST)
        self.motion.states.append((time.monotonic(), "not_ready"))
        self.client = self._opened.enter_context(
            self._serve(self._data, arm=arm, camera=camera, scan={"views": 3, "min_views": 2})
        )
        self.controller = AdminClient(host)
        self._opened.callback(self.controller.close)
        self._opened.callback(self.check_motion)
        self._motions_seen = 0
        self.client.app.state.context.cell.on_status(
            lambda status: self.motion.states.append((time.monotonic(), status.state))
        )

    def stop(self) -> None:
        """Shut the service down."""
        self._opened.close()

    def call(self, method: str, path: str, **options: Any) -> httpx2.Response:
        """Send a request and check that the answer matches the description of the API."""
        answer = self.client.request(method, path, **options)
        check_described(answer)
        return answer

    @property
    def state(self) -> str:
        """The state of the cell."""
        return self.client.app.state.context.cell.status.state

    def start_scan(self, body: dict[str, Any], key: str | None) -> httpx2.Response:
        """Request a scan. A live scan that is accepted may move the arm from now on."""
        requested = time.monotonic()
        answer = self.call("POST", "/api/scans", json=body, headers={} if key is None else {"Idempotency-Key": key})
        if answer.status_code == 202 and body["mode"] == "live":
            self.motion.requested.append(requested)
        return answer

    def stop_arm(self) -> None:
        """Stop the arm. The stop is never refused, and nothing may move after it."""
        assert self.call("POST", "/api/cell/stop").status_code == 200
        self.motion.stopped.append(time.monotonic())

    def cancel(self, scan: str) -> None:
        """Cancel a scan. If it was live and active, nothing may move after it."""
        self.journal.update()
        live = scan in self.journal.active and self.journal.scans[scan]["mode"] == "live"
        answer = self.call("POST", f"/api/scans/{scan}/cancel")
        assert slug(answer) in (None, "not-cancellable")
        if live and answer.status_code == 200 and answer.json()["state"] in ("stopping", "aborted"):
            self.motion.stopped.append(time.monotonic())

    def check_motion(self) -> None:
        """Assert that each motion in the controller's log since the last call was requested."""
        with suppress(ControllerGoneError):  # the controller starts with the first connection
            for event in self.controller.log(self._motions_seen):
                self._motions_seen = event["index"] + 1
                if event["kind"] == "motion_start":
                    self.motion.check(event["stamp_s"])

    def settle(self) -> None:
        """Wait until no scan is active and the cell is not busy."""

        def at_rest() -> bool:
            self.journal.update()
            return not self.journal.active and self.state != "busy"

        wait_until(at_rest)

    def kill_recognition(self) -> None:
        """Kill the process of recognition, as the kernel does when memory runs out."""
        with suppress(AssertionError, ProcessLookupError):  # the process is starting or has ended
            os.kill(self.client.recognition_pid, signal.SIGKILL)

    def robot(self, fault: str) -> None:
        """Cause a fault in the robot. Do nothing if the controller does not run yet."""
        with suppress(ControllerGoneError):
            getattr(self.controller, fault)()

    def camera(self, fault: Any) -> None:
        """Start or end a fault of the camera. Do nothing if it is not connected."""
        with suppress(CellError):
            self.client.app.state.context.cell.camera.fault(fault)

    @contextmanager
    def locked(self) -> Iterator[None]:
        """Run the body while another program locks the database for `LOCKED_S` seconds."""
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
        """Run retention as if some days had passed, with a maximum age of one day."""
        context = self.client.app.state.context
        self.journal.update()
        sweep(context.store, RetentionConfig(max_age_days=1), datetime.now(UTC) + timedelta(days=days), lambda: True)
        self.journal.update(removing=True)
