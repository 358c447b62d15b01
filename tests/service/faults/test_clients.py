"""Many clients request a live scan at once, and clients disconnect after their request."""

import json
import socket
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import httpx2
import pytest

from tests.service.conftest import Serve, wait_until
from tests.service.faults.figures import rounds
from tests.service.faults.moves import assert_followed_plan, events_since, log_position
from tests.service.live_cell import SCAN, LiveCell, live_cell

pytestmark = pytest.mark.xdist_group("service")  # one at a time: each test runs several busy processes

Finished = Callable[[httpx2.Client, str], dict[str, Any]]
Problem = Callable[[httpx2.Response, int, str], str]

AT_ONCE = 50


@pytest.fixture(scope="module")
def cell(serve: Serve, tmp_path_factory: pytest.TempPathFactory) -> Iterator[LiveCell]:
    """A very fast cell. Each test leaves it ready to scan."""
    with live_cell(serve, tmp_path_factory.mktemp("data"), time_factor=50.0) as shared:
        yield shared


def newest_scans(cell: LiveCell, limit: int) -> list[str]:
    """Return the ids of the newest scans, newest first."""
    return [scan["id"] for scan in cell.client.get(f"/api/scans?limit={limit}").json()["scans"]]


@pytest.mark.fault(1)
@rounds(2, 200)
def test_one_of_many_simultaneous_live_scans_is_accepted(
    cell: LiveCell, finished: Finished, assert_problem: Problem, count: int
) -> None:
    """In every other round, the arm must be connected first. All scans except the last are cancelled at once."""
    known = newest_scans(cell, 500)
    with ThreadPoolExecutor(AT_ONCE) as pool:
        for number in range(count):
            cell.is_well()
            if number % 2:
                assert cell.client.post("/api/cell/stop").status_code == 200
            begin = log_position(cell)
            requests = [pool.submit(cell.client.post, "/api/scans", json=SCAN) for _ in range(AT_ONCE)]
            answers = [answer.result() for answer in requests]
            (accepted,) = [answer for answer in answers if answer.status_code == 202]
            location = accepted.headers["Location"]
            for answer in answers:
                if answer is not accepted:
                    assert_problem(answer, 409, "cell-busy")
                    # The accepted scan has a location, or is still being prepared.
                    assert answer.headers.get("Location") == location or answer.headers["Retry-After"]
            assert newest_scans(cell, 2) == [accepted.json()["id"], *known[:1]]
            known = newest_scans(cell, 2)
            last = number == count - 1
            if last:
                assert finished(cell.client, location)["state"] == "succeeded"
                wait_until(lambda: cell.state()["state"] == "ready")
            else:
                # On a busy machine, the answer may come before the end.
                assert cell.client.post(f"{location}/cancel").json()["state"] in ("stopping", "aborted")
                assert finished(cell.client, location)["state"] == "aborted"
            assert len(events_since(cell, begin, "script_upload")) <= 1
            assert_followed_plan(cell, begin, whole=last)


@pytest.mark.fault(6)
@rounds(2, 100)
def test_a_scan_succeeds_after_its_client_disconnects(cell: LiveCell, finished: Finished, count: int) -> None:
    """Every other client disconnects before it has received the answer."""
    address = (cell.client.base_url.host, cell.client.base_url.port or 80)
    body = json.dumps(SCAN | {"views": 4})
    request = (
        f"POST /api/scans HTTP/1.1\r\nHost: {address[0]}\r\nContent-Type: application/json\r\n"
        f"Content-Length: {len(body)}\r\n\r\n{body}"
    )
    known = newest_scans(cell, 1)
    for number in range(count):
        with socket.create_connection(address) as connection:
            connection.sendall(request.encode())
            if number % 2:
                assert connection.recv(4096).startswith(b"HTTP/1.1 202 ")

        wait_until(lambda known=known: newest_scans(cell, 1) != known)
        newest, *before = newest_scans(cell, 2)
        assert before == known
        known = [newest]
        assert finished(cell.client, f"/api/scans/{newest}")["state"] == "succeeded"
        assert cell.client.get(f"/api/scans/{newest}/model").status_code == 200
