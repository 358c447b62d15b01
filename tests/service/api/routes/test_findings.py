"""Findings of a scan: in the summary, in its event, and their effect on the grasps that are listed.

The recording has a string of 4.2 mm. With 6 mm as its radius, the model has a doubt about the whole chain, which has
grasps. With 4.2 mm, it has a doubt that concerns no chain.
"""

from collections.abc import Callable
from typing import Any

import httpx2
import pytest

from recognition.model.findings import finding
from service.processing.results import MAX_SUMMARY_DOUBTS, Outcome
from service.storage.store import Store
from tests.service.conftest import ServedClient
from tests.service.following import read_events

AssertProblem = Callable[[httpx2.Response, int, str], str]
Finished = Callable[[httpx2.Client, str], dict[str, Any]]
TOO_THICK_M = 0.006
"""A radius with which the model has a doubt about its only chain."""


def start(client: httpx2.Client, recording: str, **members: Any) -> str:
    """Start a scan, which must be accepted, and return its address."""
    answer = client.post("/api/scans", json={"mode": "replay", "recording": recording, **members})
    assert answer.status_code == 202, answer.text
    return answer.headers["Location"]


def model_of(client: httpx2.Client, scan: dict[str, Any]) -> dict[str, Any]:
    """Return the model of a scan, after a check that its grasps are also those of `/grasps`."""
    model = client.get(scan["links"]["model"]).json()
    listed = client.get(scan["links"]["grasps"]).json()["grasps"]
    assert listed == [grasp | {"reach": None} for grasp in model["grasps"]]
    return model


def codes(findings: list[dict[str, Any]]) -> list[str]:
    return [found["code"] for found in findings]


def test_untrusted_grasps_are_listed_only_on_request(client: ServedClient, recording: str, finished: Finished) -> None:
    scan = finished(client, start(client, recording, string_radius_m=TOO_THICK_M))
    model = model_of(client, scan)
    (chain,) = model["chains"]
    assert (chain["trust"], chain["trusted_m"]) == ("review", [])
    assert (scan["all_grasps"], model["grasps"]) == (False, [])
    (note,) = [found for found in model["quality"]["findings"] if found["code"] == "no-trusted-grasp"]
    assert note["chains"] == [chain["id"]]

    asked = finished(client, start(client, recording, string_radius_m=TOO_THICK_M, all_grasps=True))
    model = model_of(client, asked)
    assert asked["all_grasps"] is True
    assert len(model["grasps"]) == note["value"] > 50
    assert not any(grasp["trusted"] for grasp in model["grasps"])
    assert "no-trusted-grasp" not in codes(model["quality"]["findings"])
    store: Store = client.app.state.context.store
    for document in (scan, asked):
        row = store.scans.get(document["id"])
        assert row is not None
        assert row.request.all_grasps is document["all_grasps"]


def test_grasps_of_a_chain_without_a_doubt_are_trusted(
    client: httpx2.Client, recording: str, finished: Finished
) -> None:
    models = [model_of(client, finished(client, start(client, recording, all_grasps=value))) for value in (False, True)]
    assert {model["quality"]["verdict"] for model in models} == {"review"}, "a doubt concerns the table"
    assert [model["chains"][0]["trust"] for model in models] == ["accept", "accept"]
    assert models[0]["grasps"] == models[1]["grasps"]
    assert all(grasp["trusted"] for grasp in models[0]["grasps"])


@pytest.mark.parametrize("asked", [False, True])
def test_reprocessing_keeps_or_changes_all_grasps(
    client: httpx2.Client, recording: str, finished: Finished, asked: bool
) -> None:
    source = finished(client, start(client, recording, string_radius_m=TOO_THICK_M, all_grasps=asked))
    address = source["links"]["reprocess"]
    for body, expected in (({}, asked), ({"all_grasps": None}, asked), ({"all_grasps": not asked}, not asked)):
        answer = client.post(address, json=body)
        assert answer.status_code == 202, answer.text
        again = finished(client, answer.headers["Location"])
        assert again["all_grasps"] is expected
        assert bool(model_of(client, again)["grasps"]) is expected


@pytest.mark.problem("idempotency-mismatch")
def test_all_grasps_is_part_of_an_idempotent_request(
    client: httpx2.Client, recording: str, finished: Finished, assert_problem: AssertProblem
) -> None:
    body = {"mode": "replay", "recording": recording}
    headers = {"Idempotency-Key": f"all grasps of {recording}"}
    first = client.post("/api/scans", json=body, headers=headers)
    same = client.post("/api/scans", json=body | {"all_grasps": False}, headers=headers)
    assert same.json()["id"] == first.json()["id"]
    other = client.post("/api/scans", json=body | {"all_grasps": True}, headers=headers)
    assert_problem(other, 422, "idempotency-mismatch")
    finished(client, first.headers["Location"])


@pytest.mark.parametrize("value", [1, "yes", []])
def test_all_grasps_must_be_a_boolean(
    client: httpx2.Client, recording: str, assert_problem: AssertProblem, value: object
) -> None:
    answer = client.post("/api/scans", json={"mode": "replay", "recording": recording, "all_grasps": value})
    assert "all_grasps" in assert_problem(answer, 422, "invalid-request")


def test_the_summary_has_the_verdict_and_the_doubts(client: httpx2.Client, recording: str, finished: Finished) -> None:
    scan = finished(client, start(client, recording, string_radius_m=TOO_THICK_M))
    quality = model_of(client, scan)["quality"]
    doubts = [found for found in quality["findings"] if found["severity"] != "note"]
    assert codes(doubts)[0] == "radius-much-smaller"
    assert doubts[0]["chains"] == [0]
    assert scan["summary"] == {
        "chains": 1,
        "crossings": 0,
        "verdict": "review",
        "doubts": doubts,
        "doubt_count": len(doubts),
        "note_count": len(quality["findings"]) - len(doubts),
    }
    assert scan["summary"]["note_count"] > 0
    assert client.get("/api/scans?limit=1").json()["scans"][0]["summary"] == scan["summary"]
    *_, last = read_events(client, f"{scan['links']['self']}/events", 0)
    assert (last.kind, last.data["data"]["state"]) == ("state", "succeeded")
    assert last.data["data"]["summary"] == scan["summary"]


def test_the_summary_has_a_limited_number_of_doubts() -> None:
    count = MAX_SUMMARY_DOUBTS + 5
    doubts = tuple(finding("possible-string", f"piece {k}", value=0.1) for k in range(count))
    summary = Outcome({}, 1, 0, "review", (*doubts, finding("view-missing", "view 2", view=2)), False).summary()
    assert [found["message"] for found in summary["doubts"]] == [f"piece {k}" for k in range(MAX_SUMMARY_DOUBTS)]
    assert (summary["doubt_count"], summary["note_count"]) == (count, 1)
