"""A client repeats a request with its idempotency key, and the service makes one scan."""

from collections.abc import Callable
from typing import Any

import httpx2
import pytest

from tests.service.faults.figures import rounds

Finished = Callable[[httpx2.Client, str], dict[str, Any]]
Problem = Callable[[httpx2.Response, int, str], str]


@pytest.mark.fault(2, 3)
@rounds(20, 1000)
def test_one_key_makes_one_scan(
    *, client: httpx2.Client, recording: str, finished: Finished, assert_problem: Problem, count: int
) -> None:
    key, body = {"Idempotency-Key": f"{recording} again"}, {"mode": "replay", "recording": recording}
    scan = client.post("/api/scans", json=body, headers=key).json()
    for number in range(count):
        again = client.post("/api/scans", json=body, headers=key)
        assert (again.status_code, again.headers["Idempotency-Replayed"]) == (202, "true"), again.text
        assert again.json()["id"] == scan["id"]
        other = client.post("/api/scans", json=body | {"string_radius_m": 0.001 + 1e-6 * number}, headers=key)
        assert scan["id"] in assert_problem(other, 422, "idempotency-mismatch")
    made = client.get("/api/scans", params={"recording": recording}).json()["scans"]
    assert [one["id"] for one in made] == [scan["id"]]
    finished(client, scan["links"]["self"])
