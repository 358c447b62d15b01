"""A service with a simulated cell for tests: the real ur_rtde and depthai, against the virtual controller."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from cell.camera.camera import LiveCamera
from cell.config.arm_config import SimulatedArm
from cell.config.camera_config import SimulatedCamera
from cell.config.cell_config import CellSettings
from cell.simulation.ur_controller.admin_client import AdminClient
from tests.cell.loopback import free_host
from tests.service.conftest import Serve, ServedClient, wait_until

FAST: dict[str, Any] = {"fps": 30.0, "exposures": 1, "settle_s": 0.0}
SCAN = {"mode": "live", "string_radius_m": 0.0042}


class LiveCell:
    """A service with a simulated cell, and the way to its controller's faults."""

    def __init__(self, client: ServedClient, host: str) -> None:
        self.client = client
        self.controller = AdminClient(host)

    @property
    def settings(self) -> CellSettings:
        """The service's own."""
        return self.client.app.state.context.cell.settings

    @property
    def camera(self) -> LiveCamera:
        """The service's own, to let it fail."""
        return self.client.app.state.context.cell.camera

    def start(self, **wanted: Any) -> str:
        """Starts a live scan; its address."""
        answer = self.client.post("/api/scans", json=SCAN | wanted)
        assert answer.status_code == 202, answer.text
        return answer.headers["Location"]

    def views(self, location: str) -> dict[int, str]:
        """The state of each viewpoint come to so far."""
        return {view["index"]: view["state"] for view in self.client.get(location).json()["progress"]["views"]}

    def wait_for_motion(self, location: str, views: int = 1) -> None:
        """Until so many views are recorded and the arm is on its way to the next."""

        def under_way() -> bool:
            states = list(self.views(location).values())
            assert self.client.get(location).json()["state"] in ("queued", "preflight", "scanning")
            return states.count("recorded") >= views and "moving" in states and self.moving()

        wait_until(under_way)

    def moving(self) -> bool:
        """The controller's own word."""
        return self.controller.state().moving

    def events(self, *kinds: str, after_s: float = 0.0) -> list[dict[str, Any]]:
        """What the controller has noted of these kinds."""
        return [event for event in self.controller.log() if event["kind"] in kinds and event["stamp_s"] > after_s]

    def state(self) -> dict[str, Any]:
        """The cell's document."""
        return self.client.get("/api/cell").json()

    def is_well(self) -> None:
        """Can scan again; what is under way, and be it the way home, is waited for."""
        wait_until(lambda: self.state()["state"] != "busy")
        answer = self.client.post("/api/cell/connect")
        assert answer.status_code == 200, answer.text
        assert answer.json()["state"] == "ready"


@contextmanager
def live_cell(
    serve: Serve, data: Path, time_factor: float = 20.0, scene: str = "figure-eight", **settings: Any
) -> Iterator[LiveCell]:
    """A service with a quick simulated cell at an address of its own."""
    host = free_host()
    # A busy machine may keep a thread of ours waiting for longer than the default watchdog does.
    arm = SimulatedArm(host=host, time_factor=time_factor, watchdog_hz=1.0)
    with serve(data, arm=arm, camera=SimulatedCamera(model="ideal", scene=scene, **FAST), **settings) as client:
        cell = LiveCell(client, host)
        try:
            yield cell
        finally:
            cell.controller.close()
