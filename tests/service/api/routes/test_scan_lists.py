"""Lists of scans: filters and pages."""

from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import replace
from datetime import UTC, datetime, timedelta, timezone
from pathlib import Path
from typing import Any

import httpx2
import pytest

from recognition.request import RecognitionRequest
from service.clock import format_utc
from service.jobs.submission import NOBODY, new_scan
from service.storage.data_folder import DataFolder
from service.storage.rows import ScanRow
from service.storage.scan_store import ScanFilter
from service.storage.store import Store
from tests.service.conftest import ServedClient

AssertProblem = Callable[[httpx2.Response, int, str], str]


@pytest.fixture
def store(tmp_path: Path) -> Iterator[Store]:
    with closing(DataFolder(tmp_path)) as folder, closing(Store(folder)) as store:
        yield store


def scan(name: str, **values: Any) -> ScanRow:
    values = {"state": "succeeded", "created_at": "2026-01-02T03:04:05.678Z"} | values
    return replace(new_scan("live", RecognitionRequest(), NOBODY), id=name, **values)


NOON = datetime(2026, 1, 31, 12, tzinfo=UTC)


@pytest.mark.parametrize(
    ("wanted", "found"),
    [
        (ScanFilter(), "dcba"),
        (ScanFilter(states=["failed"]), "b"),
        (ScanFilter(states=["failed", "succeeded"]), "dcba"),
        (ScanFilter(states=["partial"]), ""),
        (ScanFilter(mode="replay"), "d"),
        (ScanFilter(source="a"), "d"),
        (ScanFilter(source="a' OR 1=1 --"), ""),
        (ScanFilter(kept=True), "c"),
        (ScanFilter(kept=False), "dba"),
        (ScanFilter(created_after=NOON), "d"),
        (ScanFilter(created_before=NOON), "ba"),
        (ScanFilter(created_after=NOON - timedelta(milliseconds=1), created_before=NOON + timedelta(hours=1)), "c"),
        # stored times have milliseconds; rounding must not make a scan of this time earlier or later
        (ScanFilter(created_before=NOON + timedelta(microseconds=1)), "cba"),
        (ScanFilter(created_after=NOON.astimezone(timezone(timedelta(hours=9)))), "d"),
        (ScanFilter(states=["succeeded"], kept=False, created_before=NOON), "a"),
    ],
)
def test_a_filter_selects_the_matching_scans(store: Store, wanted: ScanFilter, found: str) -> None:
    store.scans.add(scan("a"))
    store.scans.add(scan("b", state="failed"))
    store.scans.add(scan("c", kept=True, created_at=format_utc(NOON)))
    store.scans.add(scan("d", mode="replay", source="a", created_at=format_utc(NOON + timedelta(hours=2))))
    assert "".join(row.id for row in store.scans.newest(10, matching=wanted)) == found
    assert "".join(row.id for row in store.scans.newest(10, "c", wanted)) == "".join(
        name for name in found if name < "c"
    )


@pytest.fixture(scope="module")
def recording(client: ServedClient, recording_file: Path) -> str:
    """Return the id of an uploaded recording that these tests share."""
    return client.post("/api/recordings", content=recording_file.read_bytes()).json()["id"]


@pytest.fixture(scope="module")
def three_scans(client: ServedClient, recording: str) -> list[str]:
    """Return the ids of three scans of the recording, the newest first."""
    store: Store = client.app.state.context.store
    rows = [
        replace(new_scan("replay", RecognitionRequest(), NOBODY, recording=recording), state="failed") for _ in range(3)
    ]
    for row in rows:
        store.scans.add(row)
    return [row.id for row in reversed(rows)]


def test_all_pages_together_are_the_list(client: ServedClient, recording: str, three_scans: list[str]) -> None:
    address: str | None = f"/api/scans?recording={recording}&state=failed&state=aborted&limit=2"
    pages = []
    while address is not None:
        answer = client.get(address)
        assert answer.status_code == 200, answer.text
        pages.append([scan["id"] for scan in answer.json()["scans"]])
        address = answer.json()["next"]
    assert pages == [three_scans[:2], three_scans[2:]]
    exactly = client.get("/api/scans", params={"recording": recording, "limit": 3}).json()
    assert ([scan["id"] for scan in exactly["scans"]], exactly["next"]) == (three_scans, None)


def test_recordings_are_listed_in_pages(client: ServedClient, recording_file: Path, recording: str) -> None:
    client.post("/api/recordings", content=recording_file.read_bytes())
    found, address = [], "/api/recordings?limit=1"
    for _ in range(2):
        page = client.get(address).json()
        found += [row["id"] for row in page["recordings"]]
        address = page["next"]
    assert found[1] == recording


def test_a_scan_can_be_marked_to_be_kept(
    client: ServedClient, recording: str, three_scans: list[str], assert_problem: AssertProblem
) -> None:
    address = f"/api/scans/{three_scans[1]}"
    marked = client.put(f"{address}/keep", json={"kept": True})
    assert (marked.status_code, marked.json()["kept"]) == (200, True)
    assert marked.json() == client.get(address).json()
    kept = client.get("/api/scans", params={"recording": recording, "kept": True}).json()["scans"]
    assert [scan["id"] for scan in kept] == [three_scans[1]]
    assert client.put(f"{address}/keep", json={"kept": False}).json()["kept"] is False
    assert_problem(client.put("/api/scans/none/keep", json={"kept": True}), 404, "scan-not-found")
    for body in ({}, {"kept": "yes"}, {"kept": True, "for": 3}):
        assert_problem(client.put(f"{address}/keep", json=body), 422, "invalid-request")


@pytest.mark.parametrize(
    "query",
    [
        "state=dreaming",
        "mode=dream",
        "kept=maybe",
        "source=..",
        "recording=A",
        "created_after=yesterday",
        "created_after=2026-01-31",
        "created_after=2026-01-31T12:00:00",
        "created_after=1769860800",
        "created_before=2026-01-31T12:00:00+02:00",  # the + is a space
        "before=..",
        "stat=failed",
        "limit=3&page=2",
    ],
)
def test_an_invalid_filter_is_refused(client: ServedClient, query: str, assert_problem: AssertProblem) -> None:
    detail = assert_problem(client.get(f"/api/scans?{query}"), 422, "invalid-request")
    assert query.partition("=")[0] in detail


def test_a_time_may_have_any_zone(client: ServedClient, recording: str, three_scans: list[str]) -> None:
    query = f"/api/scans?recording={recording}&created_after=2020-01-31T12:00:00%2B02:00&created_before="
    assert len(client.get(f"{query}2999-01-31t12:00:00.5z").json()["scans"]) == len(three_scans)
    assert client.get(f"{query}2020-02-01T00:00:00Z").json() == {"scans": [], "next": None}


@pytest.mark.parametrize(
    ("time", "all_are_before"),
    [
        ("0001-01-01T00:00:00%2B12:00", False),
        ("9999-12-31T23:59:59.999999Z", True),
        ("9999-12-31T23:59:59-12:00", True),
    ],
)
def test_a_time_may_be_outside_the_representable_range(
    client: ServedClient, recording: str, three_scans: list[str], time: str, all_are_before: bool
) -> None:
    query = f"/api/scans?recording={recording}"
    before = client.get(f"{query}&created_before={time}").json()["scans"]
    after = client.get(f"{query}&created_after={time}").json()["scans"]
    assert (len(before), len(after)) == ((len(three_scans), 0) if all_are_before else (0, len(three_scans)))


@pytest.mark.parametrize(("path", "known"), [("/api/scans", "created_before"), ("/api/cell", "none at this address")])
def test_an_unknown_parameter_is_named(
    client: ServedClient, path: str, known: str, assert_problem: AssertProblem
) -> None:
    answer = client.get(f"{path}?stat=failed")
    assert "query.stat: there is no such parameter" in assert_problem(answer, 422, "invalid-request")
    assert known in answer.json()["detail"]
