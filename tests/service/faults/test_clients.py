"""Clients that all want the arm at once, and clients that ask for a scan and go away."""

import json
import socket
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import httpx2
import pytest

from tests.service.conftest import Serve, wait_until
from tests.service.faults.figures import rounds
from tests.service.faults.moves import assert_one_way, now_in, seen
from tests.service.live_cell import SCAN, LiveCell, live_cell

pytestmark = pytest.mark.xdist_group("cell")  # one at a time: each is several busy processes

Finished = Callable[[httpx2.Client, str], dict[str, Any]]
Problem = Callable[[httpx2.Response, int, str], str]

AT_ONCE = 50


@pytest.fixture(scope="module")
def cell(serve: Serve, tmp_path_factory: pytest.TempPathFactory) -> Iterator[LiveCell]:
    """A very quick cell; each test leaves it able to scan."""
    with live_cell(serve, tmp_path_factory.mktemp("data"), time_factor=50.0) as shared:
        yield shared


def scans(cell: LiveCell, most: int) -> list[str]:
    """Ids of the newest."""
    return [scan["id"] for scan in cell.client.get(f"/api/scans?limit={most}").json()["scans"]]


@pytest.mark.fault(1)
@rounds(2, 200)
def test_of_many_live_scans_at_once_one_is_accepted(
    cell: LiveCell, finished: Finished, assert_problem: Problem, count: int
) -> None:
    """Every other round meets an arm that has to be connected first. All but the last are cancelled at once."""
    known = scans(cell, 500)
    with ThreadPoolExecutor(AT_ONCE) as pool:
        for number in range(count):
            cell.is_well()
            if number % 2:
                assert cell.client.post("/api/cell/stop").status_code == 200
            begin = now_in(cell)
            asked = [pool.submit(cell.client.post, "/api/scans", json=SCAN) for _ in range(AT_ONCE)]
            answers = [answer.result() for answer in asked]
            (accepted,) = [answer for answer in answers if answer.status_code == 202]
            location = accepted.headers["Location"]
            for answer in answers:
                if answer is not accepted:
                    assert_problem(answer, 409, "cell-busy")
                    # The others met it when it was accepted, or was still being prepared.
                    assert answer.headers.get("Location") == location or answer.headers["Retry-After"]
            assert scans(cell, 2) == [accepted.json()["id"], *known[:1]]
            known = scans(cell, 2)
            last = number == count - 1
            if last:
                assert finished(cell.client, location)["state"] == "succeeded"
                wait_until(lambda: cell.state()["state"] == "ready")
            else:
                assert cell.client.post(f"{location}/cancel").json()["state"] == "aborted"
            assert len(seen(cell, begin, "script_upload")) <= 1
            assert_one_way(cell, begin, whole=last)


@pytest.mark.fault(6)
@rounds(2, 100)
def test_a_client_that_goes_away_costs_no_scan(cell: LiveCell, finished: Finished, count: int) -> None:
    """Every other one does before the answer has come."""
    address = (cell.client.base_url.host, cell.client.base_url.port or 80)
    body = json.dumps(SCAN | {"views": 4})
    request = (
        f"POST /api/scans HTTP/1.1\r\nHost: {address[0]}\r\nContent-Type: application/json\r\n"
        f"Content-Length: {len(body)}\r\n\r\n{body}"
    )
    known = scans(cell, 1)
    for number in range(count):
        with socket.create_connection(address) as leaving:
            leaving.sendall(request.encode())
            if number % 2:
                assert leaving.recv(4096).startswith(b"HTTP/1.1 202 ")

        wait_until(lambda known=known: scans(cell, 1) != known)
        newest, *before = scans(cell, 2)
        assert before == known
        known = [newest]
        assert finished(cell.client, f"/api/scans/{newest}")["state"] == "succeeded"
        assert cell.client.get(f"/api/scans/{newest}/model").status_code == 200
