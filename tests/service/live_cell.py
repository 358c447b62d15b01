"""A service with a simulated cell: the real ur_rtde and depthai with the virtual controller."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from cell.camera.camera import LiveCamera
from cell.config.arm_config import SimulatedArm
from cell.config.camera_config import SimulatedCamera
from cell.config.camera_names import CameraName
from cell.config.cell_config import CellSettings
from cell.simulation.ur_controller.admin_client import AdminClient
from tests.cell.loopback import free_host
from tests.service.conftest import LONGEST_PAUSE_S, Serve, ServedClient, wait_until

FAST: dict[str, Any] = {"fps": 30.0, "exposures": 1, "settle_s": 0.0, "image_cache_bytes": 0}
SCAN = {"mode": "live", "string_radius_m": 0.0042}


class LiveCell:
    """A service with a simulated cell, and the admin client of its virtual controller."""

    def __init__(self, client: ServedClient, host: str) -> None:
        self.client = client
        self.controller = AdminClient(host)

    @property
    def settings(self) -> CellSettings:
        """Settings of the cell of the service."""
        return self.client.app.state.context.cell.settings

    @property
    def camera(self) -> LiveCamera:
        """Camera of the service, for injecting faults."""
        return self.client.app.state.context.cell.camera

    def start(self, **wanted: Any) -> str:
        """Start a live scan and return its address."""
        answer = self.client.post("/api/scans", json=SCAN | wanted)
        assert answer.status_code == 202, answer.text
        return answer.headers["Location"]

    def failure(self, **wanted: Any) -> tuple[str, str]:
        """Start a live scan that cannot be prepared. Return the slug and the detail of its problem."""
        location = self.start(**wanted)
        wait_until(lambda: self.client.get(location).json()["final"], LONGEST_PAUSE_S)
        scan = self.client.get(location).json()
        assert (scan["state"], scan["started_at"], scan["progress"]["views"]) == ("failed", None, []), scan
        return scan["problem"]["type"].removeprefix("urn:pointchain:"), scan["problem"]["detail"]

    def views(self, location: str) -> dict[int, str]:
        """Return the state of each viewpoint that was started, by its index."""
        return view_states(self.client.get(location).json())

    def wait_for_motion(self, location: str, views: int = 1) -> None:
        """Wait until `views` views are recorded and the arm moves to the next viewpoint."""

        def under_way() -> bool:
            scan = self.client.get(location).json()
            assert scan["state"] in ("queued", "connecting", "preflight", "scanning"), scan["state"]
            states = list(view_states(scan).values())
            return states.count("recorded") >= views and "moving" in states and self.moving()

        wait_until(under_way)

    def moving(self) -> bool:
        """Return whether the arm moves, as reported by the controller."""
        return self.controller.state().moving

    def events(self, *kinds: str, after_s: float = 0.0) -> list[dict[str, Any]]:
        """Return the events of these kinds in the log of the controller, later than `after_s` (monotonic seconds)."""
        return [event for event in self.controller.log() if event["kind"] in kinds and event["stamp_s"] > after_s]

    def state(self) -> dict[str, Any]:
        """Return the document of the cell."""
        return self.client.get("/api/cell").json()

    def release(self) -> None:
        """Release the arm as soon as it is home. A connected arm takes a fifth of a core, even at rest."""
        answer = self.client.post("/api/cell/release")
        assert answer.status_code == 200, answer.text

    def is_well(self) -> None:
        """Wait for the end of the current job and of the move home, and check that the cell connects."""
        wait_until(lambda: self.state()["state"] != "busy", LONGEST_PAUSE_S)
        answer = self.client.post("/api/cell/connect")
        assert answer.status_code == 200, answer.text
        assert answer.json()["state"] == "ready"


def release_used(request: pytest.FixtureRequest) -> None:
    """Release the arm of each cell that a test has used."""
    for used in request.node.funcargs.values():
        if isinstance(used, LiveCell):
            used.release()


def view_states(scan: dict[str, Any]) -> dict[int, str]:
    """Return the state of each viewpoint that was started, by its index."""
    return {view["index"]: view["state"] for view in scan["progress"]["views"]}


@contextmanager
def live_cell(
    serve: Serve,
    data: Path,
    time_factor: float = 20.0,
    scene: str = "figure-eight",
    seed: int = 0,
    model: CameraName = "exact",
    **settings: Any,
) -> Iterator[LiveCell]:
    """Yield a service with a fast simulated cell at a free loopback address."""
    host = free_host()
    # On a busy machine, a thread may wait for longer than the default timeout of the watchdog.
    arm = SimulatedArm(host=host, time_factor=time_factor, watchdog_hz=1.0)
    camera = SimulatedCamera(model=model, scene=scene, seed=seed, **FAST)
    with serve(data, arm=arm, camera=camera, **settings) as client:
        cell = LiveCell(client, host)
        try:
            yield cell
        finally:
            cell.controller.close()
