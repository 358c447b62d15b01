"""The log of a scan: its recording, its end and the reason of its end."""

import logging
import re
from collections.abc import Callable, Iterator
from typing import Any

import httpx2
import pytest

from service.processing.worker import RecognitionWorker, TaskFailedError
from tests.service.conftest import ServedClient, wait_until

Finished = Callable[[httpx2.Client, str], dict[str, Any]]


@pytest.fixture
def scan_log(caplog: pytest.LogCaptureFixture) -> Iterator[Callable[[], list[tuple[str, str]]]]:
    """`scan_log()`: level and message of each line so far, without the duration of the scan."""

    def lines() -> list[tuple[str, str]]:
        found = [record for record in caplog.records if record.name == "service.jobs.runner"]
        return [(one.levelname, re.sub(r"after \d+\.\d s", "after", one.getMessage())) for one in found]

    with caplog.at_level(logging.INFO, "service.jobs.runner"):
        yield lines


@pytest.mark.problem("aborted")
def test_a_cancelled_scan_is_logged(
    client: ServedClient, recording: str, held: int, finished: Finished, scan_log: Callable[[], list[tuple[str, str]]]
) -> None:
    location = client.post("/api/scans", json={"mode": "replay", "recording": recording}).headers["Location"]
    client.post(f"{location}/cancel")
    scan = finished(client, location)["id"]
    wait_until(lambda: len(scan_log()) == 2)  # the end is logged after it is stored
    assert scan_log() == [
        ("INFO", f"scan {scan} begins: replay of recording {recording}"),
        ("INFO", f"scan {scan} aborted after: the scan was cancelled"),
    ]


def test_a_failed_scan_is_logged_with_its_reason(
    *,
    client: ServedClient,
    recording: str,
    finished: Finished,
    scan_log: Callable[[], list[tuple[str, str]]],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def fail(*_: object) -> None:
        raise TaskFailedError("too-crowded", "there is too much above the table")

    monkeypatch.setattr(RecognitionWorker, "run", fail)
    location = client.post("/api/scans", json={"mode": "replay", "recording": recording}).headers["Location"]
    scan = finished(client, location)["id"]
    wait_until(lambda: len(scan_log()) == 2)
    assert scan_log()[1:] == [("WARNING", f"scan {scan} failed after: too-crowded: there is too much above the table")]
