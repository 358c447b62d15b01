"""Errors and retries of the client when the service, or a proxy in front of it, does not answer as it should."""

import json
from dataclasses import replace
from typing import Any

import httpx2
import pytest

from pointchain_client import (
    AnswerError,
    NotEndedError,
    ProblemError,
    Scan,
    ScanFailedError,
    UnansweredError,
    UnreachableError,
    flows,
    retry,
)
from pointchain_client.documents.decoding import decode
from recognition.request import RecognitionRequest
from service.api.schemas.scan_resource import scan_resource
from service.errors import Failure
from service.jobs.submission import NOBODY, new_scan
from tests.service.client.answers import (
    KINDS,
    Answer,
    ScriptedTransport,
    event_answer,
    json_answer,
    no_answer,
    planner_for,
    problem_answer,
    proxy_answer,
)

ROW = new_scan("replay", RecognitionRequest(), NOBODY)
ACCEPTED = scan_resource(ROW, []).model_dump(mode="json")
SCAN = decode(Scan, ACCEPTED)
PENDING = problem_answer(409, "idempotency-pending", **{"Retry-After": "0"})


def ended_scan(state: Any, slug: str | None = None) -> dict[str, Any]:
    """Return the scan resource in a final state."""
    failure = None if slug is None else Failure(slug, "the service was stopped")
    return scan_resource(replace(ROW, state=state, failure=failure), []).model_dump(mode="json")


@pytest.fixture(autouse=True)
def no_pauses(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(retry, "RETRY_INTERVAL_S", 0.01)


@pytest.fixture(params=KINDS)
def kind(request: pytest.FixtureRequest) -> str:
    """Kind of the client under test."""
    return request.param


@pytest.mark.parametrize(
    "failure",
    [no_answer(), no_answer(httpx2.ReadError), problem_answer(503, "not-ready"), proxy_answer(502), proxy_answer(504)],
)
def test_wait_survives_a_restart_that_interrupts_the_scan(kind: str, failure: Answer) -> None:
    """A stopping service reports `interrupted`, and then its port is closed for a while."""
    interrupted = ended_scan("interrupted", "interrupted")
    service = ScriptedTransport(event_answer(("scan", interrupted)), *[failure] * 6, json_answer(interrupted))
    with planner_for(kind, service) as planner, pytest.raises(ScanFailedError, match="was stopped") as failed:
        planner.wait(SCAN)
    assert (failed.value.slug, failed.value.scan.state) == ("interrupted", "interrupted")
    assert [request.url.path.endswith("/events") for request in service.requests] == [True, *[False] * 7]


def test_the_last_request_of_wait_has_a_time_limit(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    stream = event_answer(("scan", ended_scan("succeeded")))
    with planner_for(kind, ScriptedTransport(stream, no_answer())) as planner, pytest.raises(TimeoutError) as late:
        planner.wait(SCAN, timeout_s=0.1)
    assert isinstance(late.value, NotEndedError)
    assert late.value.scan_id == ROW.id
    service = ScriptedTransport(stream, json_answer(ended_scan("succeeded")))
    with planner_for(kind, service) as planner:
        planner.wait(SCAN, timeout_s=5.0)
    assert all(request.extensions["timeout"]["read"] <= 5.0 for request in service.requests)
    monkeypatch.setattr(retry, "MAX_OUTAGE_S", 0.05)
    with (
        planner_for(kind, ScriptedTransport(stream, no_answer())) as planner,
        pytest.raises(UnreachableError, match="has not answered for"),
    ):
        planner.wait(SCAN)


def test_wait_reports_a_failed_scan_even_if_the_service_stays_down(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    stream = event_answer(("scan", ACCEPTED), ("state", {"data": {"state": "interrupted"}, "kind": "state"}))
    monkeypatch.setattr(flows, "FINAL_STATE_TIMEOUT_S", 0.05)
    for scan, before in ((SCAN, []), (ROW.id, [json_answer(ACCEPTED)])):
        with (
            planner_for(kind, ScriptedTransport(*before, stream, no_answer())) as planner,
            pytest.raises(ScanFailedError) as failed,
        ):
            planner.wait(scan)
        assert (failed.value.scan.id, failed.value.scan.state) == (ROW.id, "interrupted")


def test_start_waits_while_its_key_is_pending(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    service = ScriptedTransport(PENDING, PENDING, json_answer(ACCEPTED, 202))
    with planner_for(kind, service) as planner:
        assert planner.start({"mode": "live"}, key="the same").id == ROW.id
    assert [request.headers["Idempotency-Key"] for request in service.requests] == ["the same"] * 3
    assert {request.content for request in service.requests} == {service.requests[0].content}
    assert json.loads(service.requests[0].content) == {"mode": "live"}
    with (
        planner_for(kind, ScriptedTransport(PENDING, problem_answer(409, "cell-busy"))) as planner,
        pytest.raises(ProblemError) as busy,
    ):
        planner.start({"mode": "live"}, key="the same")
    assert busy.value.slug == "cell-busy"
    # the first request may have started a scan, so the error must not say that nothing was started
    with (
        planner_for(kind, ScriptedTransport(PENDING, no_answer())) as planner,
        pytest.raises(UnansweredError, match="may have been started"),
    ):
        planner.start({"mode": "live"}, key="the same")
    monkeypatch.setattr(flows, "ANSWER_TIMEOUT_S", 0.05)
    with planner_for(kind, ScriptedTransport(PENDING)) as planner, pytest.raises(UnansweredError) as undecided:
        planner.start({"mode": "live"}, key="the same")
    assert (undecided.value.request, undecided.value.key) == ({"mode": "live"}, "the same")


@pytest.mark.parametrize("failure", [no_answer(httpx2.ReadTimeout), proxy_answer(502), proxy_answer(504)])
def test_a_request_that_may_have_arrived_raises_unanswered(kind: str, failure: Answer) -> None:
    service = ScriptedTransport(failure, json_answer(ACCEPTED, 202))
    with planner_for(kind, service) as planner, pytest.raises(UnansweredError, match="may have been started"):
        planner.start({"mode": "live"})
    assert len(service.requests) == 1, "a motion must not be requested twice"


@pytest.mark.parametrize("failure", [no_answer(httpx2.ConnectError), no_answer(httpx2.ConnectTimeout)])
def test_a_request_that_was_not_sent_has_started_nothing(kind: str, failure: Answer) -> None:
    with (
        planner_for(kind, ScriptedTransport(failure)) as planner,
        pytest.raises(UnreachableError, match="nothing was started") as error,
    ):
        planner.start({"mode": "live"})
    assert not isinstance(error.value, UnansweredError)


@pytest.mark.parametrize(
    "failure", [no_answer(), no_answer(httpx2.ReadTimeout), proxy_answer(502), proxy_answer(503), proxy_answer(504)]
)
def test_a_stop_is_repeated(kind: str, failure: Answer) -> None:
    service = ScriptedTransport(failure, failure, json_answer({}))
    with planner_for(kind, service) as planner:
        planner.stop()
    assert len(service.requests) == flows.MAX_STOP_ATTEMPTS == 3


@pytest.mark.parametrize("failure", [no_answer(httpx2.ConnectError), no_answer(httpx2.ConnectTimeout)])
def test_a_stop_that_cannot_be_sent_is_reported(kind: str, failure: Answer) -> None:
    service = ScriptedTransport(failure)
    with planner_for(kind, service) as planner, pytest.raises(UnreachableError, match="the stop was not sent") as error:
        planner.stop()
    assert str(error.value).endswith("use the robot's own stop")
    assert len(service.requests) == flows.MAX_STOP_ATTEMPTS


@pytest.mark.parametrize(
    "tries", [[no_answer(httpx2.ReadTimeout)], [no_answer(httpx2.ReadError), no_answer()], [proxy_answer(504)]]
)
def test_a_stop_that_is_not_confirmed_is_reported(kind: str, tries: list[Answer]) -> None:
    service = ScriptedTransport(*tries)
    with (
        planner_for(kind, service) as planner,
        pytest.raises(UnreachableError, match="sent and not confirmed") as error,
    ):
        planner.stop()
    assert "check whether the arm moves" in str(error.value)
    assert len(service.requests) == flows.MAX_STOP_ATTEMPTS


REDIRECTION = json_answer({}, 302)


@pytest.mark.parametrize("answer", [REDIRECTION, lambda _: httpx2.Response(200, html="<h1>Sign in</h1>")])
def test_an_answer_of_another_server_is_no_confirmation_of_a_stop(kind: str, answer: Answer) -> None:
    with (
        planner_for(kind, ScriptedTransport(answer)) as planner,
        pytest.raises(UnreachableError, match="sent and not confirmed"),
    ):
        planner.stop()


def test_an_answer_that_cannot_be_read_may_have_started_a_scan(kind: str) -> None:
    unreadable = json_answer({name: value for name, value in ACCEPTED.items() if name != "links"}, 202)
    service = ScriptedTransport(unreadable)
    with planner_for(kind, service) as planner, pytest.raises(UnansweredError, match="member links is missing"):
        planner.start({"mode": "live"})
    assert len(service.requests) == 1


def test_an_answer_of_another_server_is_no_document(kind: str) -> None:
    with planner_for(kind, ScriptedTransport(REDIRECTION)) as planner, pytest.raises(UnreachableError, match="302"):
        planner.cell()
    with (
        planner_for(kind, ScriptedTransport(json_answer({"state": "ready"}))) as planner,
        pytest.raises(AnswerError, match="did not answer with a Cell: the member problem is missing"),
    ):
        planner.cell()


def test_the_filters_of_the_first_page_are_sent_once(kind: str) -> None:
    first = json_answer({"scans": [ACCEPTED], "next": "/api/scans?before=x&mode=live"})
    service = ScriptedTransport(first, json_answer({"scans": [], "next": None}))
    with planner_for(kind, service) as planner:
        assert [scan.id for scan in planner.scans(mode="live", state=["queued", "failed"], kept=True)] == [ROW.id]
    queries = [request.url.query.decode() for request in service.requests]
    assert queries == ["mode=live&state=queued&state=failed&kept=true", "before=x&mode=live"]
