"""Fault 24: damaged and hostile recordings and names, and uploads that are too large."""

import hashlib
import json
import random
import re
import socket
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import httpx2
import pytest

from service.integrity.check import check_store
from tests.service.faults.hostile_recordings import NAMES, hostile
from tests.service.service_process import process
from tests.service.stored_data import check_target_of

pytestmark = [
    pytest.mark.fault(24),
    pytest.mark.skipif(not Path("/proc").is_dir(), reason="reads the service's memory from /proc"),
]

MIB = 1 << 20
GROWTH_BYTES = 256 * MIB
"""Limit of the growth of the service's memory."""
ANSWER_S = 2.0
"""Time limit of each answer, in seconds. It is asserted only in the long form."""
UPLOAD_BYTES = 4 * MIB
"""Configured limit of an upload."""


@dataclass(frozen=True)
class Served:
    """A service in another process, and the folder that contains its data folder."""

    client: httpx2.Client
    pid: int
    parent: Path

    @property
    def data(self) -> Path:
        """The data folder of the service."""
        return self.parent / "data"

    @property
    def peak_bytes(self) -> int:
        """The peak memory of the service, in bytes."""
        found = re.search(r"VmHWM:\s+(\d+) kB", Path(f"/proc/{self.pid}/status").read_text())
        assert found is not None
        return int(found[1]) * 1024

    def outside(self) -> dict[str, tuple[int, int, str]]:
        """Return size, modification time in ns and hash of each file outside the data folder."""
        files = (path for path in self.parent.rglob("*") if path.is_file() and self.data not in path.parents)
        return {
            str(path): (path.stat().st_size, path.stat().st_mtime_ns, hashlib.sha256(path.read_bytes()).hexdigest())
            for path in files
            if path.name != "service.log"
        }


@pytest.fixture(scope="module")
def served(tmp_path_factory: pytest.TempPathFactory, recording_file: Path) -> Iterator[Served]:
    """A service with one recording and a low limit of uploads."""
    parent = tmp_path_factory.mktemp("around")
    for name in ("hand_eye.json", "lock", "evil.mcap"):
        (parent / name).write_text("not to be touched")
    limits = {"POINTCHAIN_LIMITS__UPLOAD_BYTES": str(UPLOAD_BYTES), "POINTCHAIN_LIMITS__MIN_FREE_BYTES": "0"}
    with process(parent / "data", parent / "service.log", **limits) as (running, client):
        client.post("/api/recordings", content=recording_file.read_bytes())
        yield Served(client, running.pid, parent)


@pytest.mark.parametrize(
    "count", [25, pytest.param(500, marks=[pytest.mark.soak, pytest.mark.timeout(3600)])], ids=["some", "all"]
)
def test_hostile_recordings_do_no_harm(served: Served, recording_file: Path, count: int) -> None:
    content, before, memory = recording_file.read_bytes(), served.outside(), served.peak_bytes
    accepted, slowest_s, refused = len(list((served.data / "recordings").iterdir())), 0.0, set[str]()
    for number in range(count):
        kind, upload = hostile(content, number)
        started_s = time.monotonic()
        answer = served.client.post("/api/recordings", content=upload)
        slowest_s = max(slowest_s, time.monotonic() - started_s)
        assert answer.status_code in (201, 413, 422), (kind, answer.text)
        accepted += answer.status_code == 201
        if answer.status_code != 201:
            assert answer.headers["content-type"] == "application/problem+json", kind
            assert "unexpected" not in answer.json()["detail"], (kind, answer.text)
            refused.add(answer.json()["type"])
    assert len(refused) >= 3, refused
    assert served.peak_bytes - memory <= GROWTH_BYTES
    assert served.outside() == before
    assert len(list((served.data / "recordings").iterdir())) == accepted
    assert list((served.data / "incoming").iterdir()) == []
    assert check_store(check_target_of(served.data)).findings == ()
    if count == 500:
        assert slowest_s <= ANSWER_S


@pytest.mark.parametrize("count", [50, pytest.param(2000, marks=pytest.mark.soak)], ids=["some", "all"])
def test_hostile_names_do_no_harm(served: Served, count: int) -> None:
    before, rng = served.outside(), random.Random(24)
    names = [*NAMES, "%2e%2e", "'; DROP TABLE scans; --", "{{7*7}}", "\r\nSet-Cookie: a=b", "\ud800", "9" * 10_000]
    for _ in range(count):
        name = rng.choice(names)
        if rng.random() < 0.3:
            name = "".join(rng.choices([*"./\\%~\0\n", "..", "%2f", "a", "\u0130", "\U0001f600"], k=10))
        bodies = {"/api/scans": {"mode": "replay", "recording": name}, "/api/viewpoints/plan": {name: name}}
        path, body = rng.choice(list(bodies.items()))
        # The client would refuse to send bytes that are not allowed in a header.
        key = re.sub(rb"[\0\r\n]", b"", name[:300].encode("utf-8", "replace")).strip()
        # JSON in ASCII can carry lone surrogates.
        answer = served.client.post(path, content=json.dumps(body), headers=[(b"Idempotency-Key", key)])
        assert answer.status_code in (400, 404, 413, 422), (name, answer.status_code, answer.text)
        answer = served.client.get("/api/scans", params={"before": name.encode("utf-8", "replace")})
        assert answer.status_code in (200, 400, 414, 422), (name, answer.text)
    assert served.outside() == before
    assert served.client.get("/api/scans").json()["scans"] == []


def test_an_upload_of_ten_gigabytes_is_not_read(served: Served) -> None:
    before, memory = served.outside(), served.peak_bytes
    port = served.client.base_url.port
    for head in (f"Content-Length: {10 * 10**9}", "Transfer-Encoding: chunked"):
        started_s, sent = time.monotonic(), 0
        with socket.create_connection(("127.0.0.1", port), timeout=60) as connection:
            connection.sendall(f"POST /api/recordings HTTP/1.1\r\nHost: localhost\r\n{head}\r\n\r\n".encode())
            part = bytes(64 << 10)
            answer = b""
            while not answer and sent < 10 * 10**9 and time.monotonic() < started_s + 60:
                connection.settimeout(0.05 if sent > 2 * UPLOAD_BYTES else 0.0)
                try:
                    answer = connection.recv(65536)
                except (BlockingIOError, TimeoutError):
                    connection.settimeout(1.0)
                    sent += _send(connection, part if "chunked" not in head else b"10000\r\n" + part + b"\r\n")
            connection.settimeout(60)
            with suppress(ConnectionError):  # the service closes the connection with unread data
                while more := connection.recv(65536):
                    answer += more
        assert answer.startswith(b"HTTP/1.1 413 "), answer[:200]
        assert b"urn:pointchain:too-large" in answer
        assert sent < 50 * MIB  # data in the buffers of the connection
    assert served.peak_bytes - memory <= 64 * MIB
    assert served.outside() == before
    assert list((served.data / "incoming").iterdir()) == []


def _send(connection: socket.socket, part: bytes) -> int:
    """Send a part and return the number of bytes; 0 if the connection does not accept it."""
    try:
        connection.sendall(part)
    except (TimeoutError, ConnectionError):
        return 0
    return len(part)
