"""Many live scans in a row: each succeeds, memory does not grow, and no process or port is left."""

import os
import socket
from pathlib import Path

import pytest

from cell.config.arm_config import SimulatedArm
from cell.config.camera_config import SimulatedCamera
from tests.cell.loopback import free_host
from tests.processes import children, rss_bytes, state
from tests.service.conftest import Serve, wait_until

pytestmark = pytest.mark.xdist_group("service")  # one at a time, because each test runs several busy processes

WARM_UP = 0.2
"""Share of the scans after which memory is measured first. Buffers and caches have filled by then."""
GROWTH = 1.05
"""Maximum ratio of the memory of a process at the end to that after the warm-up, plus `GROWTH_BYTES`."""
GROWTH_BYTES = 8 << 20
"""Maximum growth in addition, bytes: the steps of an allocator."""


@pytest.mark.parametrize(
    "scans",
    [
        2,
        pytest.param(500, marks=[pytest.mark.soak, pytest.mark.timeout(7200)]),
    ],
)
def test_scans_in_a_row_leak_nothing(serve: Serve, tmp_path: Path, scans: int) -> None:
    host, before = free_host(), processes()
    arm = SimulatedArm(host=host, time_factor=50.0, watchdog_hz=1.0)
    camera = SimulatedCamera(model="exact", fps=60.0, exposures=1, settle_s=0.0)
    with serve(tmp_path / "data", arm=arm, camera=camera) as client:
        warm: dict[int, int] = {}
        for number in range(scans):
            location = client.post("/api/scans", json={"mode": "live", "string_radius_m": 0.0042}).headers["Location"]
            scan = {}

            def ended(location: str = location, scan: dict = scan) -> bool:
                scan.update(client.get(location).json())
                return scan["ended_at"] is not None

            wait_until(ended)
            assert scan["state"] == "succeeded", (number, scan)
            assert scan["summary"]["chains"] == 1
            assert scan["summary"]["crossings"] == 1
            running = processes() - before
            assert not [pid for pid in running if state(pid) == "Z"], "a zombie process is left"
            if number + 1 == max(1, round(WARM_UP * scans)):
                warm = {pid: rss_bytes(pid) for pid in running | {os.getpid()}}
        if scans > 100:  # fewer scans do not complete the warm-up
            grown = {pid: (then, rss_bytes(pid)) for pid, then in warm.items()}
            print({name(pid): sizes for pid, sizes in grown.items()})
            for pid, (then, now) in grown.items():
                assert now <= GROWTH * then + GROWTH_BYTES, f"{name(pid)} grew from {then} to {now} bytes"
            assert set(warm) == processes() - before | {os.getpid()}, "a process was started or has ended"
    assert processes() <= before  # processes that other tests share may have ended meanwhile
    for port in (29900, 29999, 30003, 30004):
        with socket.socket() as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind((host, port))  # raises if a process still listens


def processes() -> set[int]:
    """Return the ids of all descendants of this process, with zombies, without the resource tracker."""
    found: set[int] = set()
    new = {os.getpid()}
    while new:
        found |= new
        new = {child for pid in new for child in children(pid)} - found
    return {pid for pid in found - {os.getpid()} if "resource_tracker" not in name(pid)}


def name(pid: int) -> str:
    """Return the start of the command line of a process."""
    try:
        return Path(f"/proc/{pid}/cmdline").read_text().replace("\0", " ")[:100]
    except (FileNotFoundError, ProcessLookupError):
        return str(pid)
