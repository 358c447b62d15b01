"""The metrics at `/metrics` match what happened."""

import re
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, get_args

import httpx2
import pytest
from prometheus_client import CollectorRegistry

from cell.recording import RecordingWriter, read_recording
from recognition.model.finding_types import FINDING_TYPES
from recognition.model.trust import Verdict
from service.logs.request_time import arrival_time, request_arrival
from service.metrics.scans import ScanMetrics
from service.metrics.state import StoreSizes
from service.processing.view_outcomes import ViewOutcome
from tests.service.conftest import MetricValues, metric_values, wait_until

Finished = Callable[[httpx2.Client, str], dict[str, Any]]
FINDINGS, VERDICTS, SCANS = "pointchain_findings_total", "pointchain_verdicts_total", "pointchain_scans_total"


def value(found: MetricValues, name: str, **labels: str) -> float:
    return found[name, tuple(sorted(labels.items()))]


def test_a_scan_is_counted_with_its_stages_and_its_views(
    client: httpx2.Client, recording: str, finished: Finished
) -> None:
    before = metric_values(client)
    answer = client.post("/api/scans", json={"mode": "replay", "recording": recording})
    scan = finished(client, answer.headers["location"])
    assert scan["state"] == "succeeded", scan["problem"]
    client.get(scan["links"]["preview"])  # it is ready only after the metrics of the scan are recorded
    after = metric_values(client)

    def increase(name: str, **labels: str) -> float:
        key = name, tuple(sorted(labels.items()))
        return after[key] - before.get(key, 0.0)

    assert increase("pointchain_scans_total", mode="replay", outcome="succeeded") == 1
    assert increase("pointchain_scans_total", mode="live", outcome="succeeded") == 0
    assert increase("pointchain_scan_seconds_count", mode="replay") == 1
    timing = client.get(scan["links"]["model"]).json()["timing_s"]
    for stage, seconds in timing.items():
        assert increase("pointchain_recognition_stage_seconds_count", stage=stage) == 1
        assert increase("pointchain_recognition_stage_seconds_sum", stage=stage) == pytest.approx(seconds, abs=1e-3)
    assert increase("pointchain_registration_correction_metres_count") == 4
    assert increase("pointchain_registration_correction_radians_count") == 4
    assert increase("pointchain_http_requests_total", method="POST", route="/api/scans", status="202") == 1
    # The label is the template of the route; an id is never a label.
    assert increase("pointchain_http_requests_total", method="GET", route="/api/scans/{id}", status="200") >= 1
    assert not any(scan["id"] in str(labels) for _, labels in after)


def test_verdicts_and_findings_are_counted(client: httpx2.Client, recording: str, finished: Finished) -> None:
    before = metric_values(client)
    body = {"mode": "replay", "recording": recording, "string_radius_m": 0.006}  # the string has 4.2 mm
    scan = finished(client, client.post("/api/scans", json=body).headers["Location"])
    client.get(scan["links"]["preview"])  # it is ready only after the metrics of the scan are recorded
    after = metric_values(client)
    quality = client.get(scan["links"]["model"]).json()["quality"]
    expected = Counter((found["code"], found["severity"]) for found in quality["findings"])
    assert expected["radius-much-smaller", "doubt"] == expected["no-trusted-grasp", "note"] == 1
    for code, finding_type in FINDING_TYPES.items():
        labels = {"code": code, "severity": finding_type.severity}
        increase = value(after, FINDINGS, **labels) - value(before, FINDINGS, **labels)
        assert increase == expected[code, finding_type.severity], code
    assert sum(name == FINDINGS for name, _ in after) == len(FINDING_TYPES)
    assert quality["verdict"] == "review"
    for verdict in get_args(Verdict):
        increase = value(after, VERDICTS, verdict=verdict) - value(before, VERDICTS, verdict=verdict)
        assert increase == (verdict == "review"), verdict


def test_a_failed_scan_has_no_verdict(
    client: httpx2.Client, recording_file: Path, finished: Finished, tmp_path: Path
) -> None:
    source = read_recording(recording_file)
    nowhere = replace(source.header, workspace_m=((5.0, 6.0), (5.0, 6.0), (0.0, 0.1)))  # no depth is in it
    with RecordingWriter(tmp_path / "nowhere.mcap", nowhere) as writer:
        for view in source.views:
            writer.write_view(view)
    uploaded = client.post("/api/recordings", content=(tmp_path / "nowhere.mcap").read_bytes()).json()["id"]
    before = metric_values(client)
    body = {"mode": "replay", "recording": uploaded}
    assert finished(client, client.post("/api/scans", json=body).headers["Location"])["state"] == "failed"
    failed = SCANS, (("mode", "replay"), ("outcome", "failed"))
    wait_until(lambda: metric_values(client).get(failed, 0.0) == before.get(failed, 0.0) + 1)
    after = metric_values(client)
    for name in (FINDINGS, VERDICTS):
        counted = [[count for (each, _), count in found.items() if each == name] for found in (before, after)]
        assert counted[0] == counted[1]


def test_all_unknown_addresses_have_one_label(client: httpx2.Client) -> None:
    before = len(metric_values(client))
    for number in range(20):
        client.get(f"/api/nothing-{number}")
        client.request(f"WHAT{number}", "/api/scans")
    after = metric_values(client)
    labelled = [key for key in after if "nothing-" in str(key) or "WHAT" in str(key)]
    assert labelled == []
    assert len(after) - before < 100


def test_the_current_state_is_reported(client: httpx2.Client) -> None:
    found = metric_values(client)
    state = client.get("/api/cell").json()["state"]
    assert value(found, "pointchain_cell_state", state=state) == 1
    assert sum(v for (name, _), v in found.items() if name == "pointchain_cell_state") == 1
    assert value(found, "pointchain_event_streams_open") == 0
    assert value(found, "pointchain_data_free_bytes") > 0
    assert value(found, "pointchain_store_bytes", kind="database") > 0
    assert value(found, "pointchain_recognition_restarts_total") >= 0
    assert value(found, "process_resident_memory_bytes") > 0
    (build,) = [dict(labels) for name, labels in found if name == "pointchain_build_info"]
    assert re.fullmatch(r"\d+\.\d+.*", build["version"])
    # Names end with their unit.
    ours = {name for name, _ in found if name.startswith("pointchain_")}
    units = re.compile(r"_(seconds|metres|radians|bytes)(_bucket|_sum|_count|_created)?$|_(total|created|info)$")
    plain = {"pointchain_cell_state", "pointchain_robot_mode", "pointchain_robot_safety_mode"}
    assert {name for name in ours if not units.search(name)} - plain <= {
        "pointchain_event_streams_open",
        "pointchain_arm_moving",
    }


def test_a_stop_is_timed_from_the_arrival_of_its_request(client: httpx2.Client) -> None:
    before = metric_values(client)
    assert client.post("/api/cell/stop").status_code == 200
    after = metric_values(client)
    assert value(after, "pointchain_stop_seconds_count") == value(before, "pointchain_stop_seconds_count") + 1
    with request_arrival() as at:
        assert arrival_time() == at
    assert arrival_time() > at


def test_unused_views_are_counted_by_their_reason() -> None:
    registry = CollectorRegistry()
    metrics = ScanMetrics(registry)
    assert registry.get_sample_value("pointchain_view_failures_total", {"reason": "camera"}) == 0
    metrics.count_missing_view("camera")
    metrics.count_recorded_view()
    views = (
        ViewOutcome(0, None, 0.0004, 0.003),
        ViewOutcome(1, "inconsistent", None, None),
        ViewOutcome(2, "empty", None, None),
    )
    metrics.observe_recognition({"registration": 0.3, "made-up": 1.0}, views)

    def sample(name: str, **labels: str) -> float | None:
        return registry.get_sample_value(name, labels)

    for reason in ("camera", "inconsistent", "empty"):
        assert sample("pointchain_view_failures_total", reason=reason) == 1
    assert sample("pointchain_views_total", result="excluded") == 2
    assert (
        sample("pointchain_views_total", result="missing") == sample("pointchain_views_total", result="recorded") == 1
    )
    assert sample("pointchain_registration_correction_metres_sum") == pytest.approx(0.0004)
    assert sample("pointchain_recognition_stage_seconds_sum", stage="other") == 1.0
    metrics.observe_scan("live", "aborted", 3.0)
    assert sample("pointchain_scans_total", mode="live", outcome="aborted") == 1
    assert sample("pointchain_scan_seconds_count", mode="live") is None  # it has no result


def test_sizes_are_those_of_the_files(tmp_path: Path) -> None:
    for name in ("recordings/a.mcap", "scans/s1/model.json", "pointchain.sqlite3", "pointchain.sqlite3-wal"):
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(b"x" * 10)
    sizes = StoreSizes(tmp_path)
    assert sizes.latest() == {"database": 20, "recordings": 10, "results": 10}
    (tmp_path / "recordings" / "b.mcap").write_bytes(b"x")
    assert sizes.latest()["recordings"] == 10  # read once a minute
