"""What the client does while the service, or what is in front of it, does not answer as it should."""

import json
from dataclasses import replace
from typing import Any

import httpx
import pytest

from service.api.schemas.scan_resource import scan_resource
from service.api.schemas.scans import ScanResource
from service.client import (
    NotEndedError,
    ProblemError,
    ScanFailedError,
    UnansweredError,
    UnreachableError,
    client,
    retry,
)
from service.errors import Failure
from service.jobs.new_rows import NOBODY, new_scan
from tests.service.client.answers import Answer, Answers, events, found, lost, planner_of, proxy, refused

ROW = new_scan("replay", "graph", None, NOBODY)
ACCEPTED = scan_resource(ROW, []).model_dump(mode="json")
SCAN = ScanResource.model_validate(ACCEPTED)
PENDING = refused(409, "idempotency-pending", **{"Retry-After": "0"})


def ended(state: Any, slug: str | None = None) -> dict[str, Any]:
    """The scan's resource at its end."""
    failure = None if slug is None else Failure(slug, "the service was stopped")
    return scan_resource(replace(ROW, state=state, failure=failure), []).model_dump(mode="json")


@pytest.fixture(autouse=True)
def at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    for module in (client, retry):
        monkeypatch.setattr(module, "AGAIN_S", 0.01)


@pytest.mark.parametrize("away", [lost(), lost(httpx.ReadError), refused(503, "not-ready"), proxy(502), proxy(504)])
def test_a_wait_outlives_a_restart_that_ends_the_scan(away: Answer) -> None:
    """The last thing that a service tells that is ending is `interrupted`; then its port is closed for a while."""
    interrupted = ended("interrupted", "interrupted")
    service = Answers(events(("scan", interrupted)), *[away] * 6, found(interrupted))
    with planner_of(service) as planner, pytest.raises(ScanFailedError, match="was stopped") as failed:
        planner.wait(SCAN)
    assert (failed.value.slug, failed.value.scan.state) == ("interrupted", "interrupted")
    assert [request.url.path.endswith("/events") for request in service.asked] == [True, *[False] * 7]


def test_the_last_look_has_an_end_too(monkeypatch: pytest.MonkeyPatch) -> None:
    told = events(("scan", ended("succeeded")))
    with planner_of(Answers(told, lost())) as planner, pytest.raises(TimeoutError) as late:
        planner.wait(SCAN, timeout_s=0.1)
    assert isinstance(late.value, NotEndedError)
    assert late.value.scan_id == ROW.id
    service = Answers(told, found(ended("succeeded")))
    with planner_of(service) as planner:
        planner.wait(SCAN, timeout_s=5.0)
    assert all(request.extensions["timeout"]["read"] <= 5.0 for request in service.asked)
    monkeypatch.setattr(retry, "LOST_S", 0.05)
    with planner_of(Answers(told, lost())) as planner, pytest.raises(UnreachableError, match="has not answered for"):
        planner.wait(SCAN)


def test_how_a_scan_failed_is_told_though_the_service_does_not_come_back(monkeypatch: pytest.MonkeyPatch) -> None:
    told = events(("scan", ACCEPTED), ("state", {"data": {"state": "interrupted"}, "kind": "state"}))
    monkeypatch.setattr(client, "END_S", 0.05)
    for scan, before in ((SCAN, []), (ROW.id, [found(ACCEPTED)])):
        with planner_of(Answers(*before, told, lost())) as planner, pytest.raises(ScanFailedError) as failed:
            planner.wait(scan)
        assert (failed.value.scan.id, failed.value.scan.state) == (ROW.id, "interrupted")


def test_a_key_that_is_being_decided_on_is_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    service = Answers(PENDING, PENDING, found(ACCEPTED, 202))
    with planner_of(service) as planner:
        assert planner.start({"mode": "live"}, key="the same").id == ROW.id
    assert [request.headers["Idempotency-Key"] for request in service.asked] == ["the same"] * 3
    assert {request.content for request in service.asked} == {service.asked[0].content}
    assert json.loads(service.asked[0].content) == {"mode": "live"}
    with planner_of(Answers(PENDING, refused(409, "cell-busy"))) as planner, pytest.raises(ProblemError) as busy:
        planner.start({"mode": "live"}, key="the same")
    assert busy.value.slug == "cell-busy"
    # What became of the first request is not known, so nobody says that nothing was begun.
    with planner_of(Answers(PENDING, lost())) as planner, pytest.raises(UnansweredError, match="is not known"):
        planner.start({"mode": "live"}, key="the same")
    monkeypatch.setattr(client, "ANSWER_S", 0.05)
    with planner_of(Answers(PENDING)) as planner, pytest.raises(UnansweredError) as undecided:
        planner.start({"mode": "live"}, key="the same")
    assert (undecided.value.wish, undecided.value.key) == ({"mode": "live"}, "the same")


@pytest.mark.parametrize("away", [lost(httpx.ReadTimeout), proxy(502), proxy(504)])
def test_a_request_that_may_have_arrived_is_unanswered(away: Answer) -> None:
    service = Answers(away, found(ACCEPTED, 202))
    with planner_of(service) as planner, pytest.raises(UnansweredError, match="is not known"):
        planner.start({"mode": "live"})
    assert len(service.asked) == 1, "a motion is not asked for twice"


@pytest.mark.parametrize("away", [lost(httpx.ConnectError), lost(httpx.ConnectTimeout)])
def test_one_that_was_never_sent_has_begun_nothing(away: Answer) -> None:
    with planner_of(Answers(away)) as planner, pytest.raises(UnreachableError, match="nothing was begun") as error:
        planner.start({"mode": "live"})
    assert not isinstance(error.value, UnansweredError)


@pytest.mark.parametrize("away", [lost(), lost(httpx.ReadTimeout), proxy(502), proxy(503), proxy(504)])
def test_a_stop_is_tried_again(away: Answer) -> None:
    service = Answers(away, away, found({}))
    with planner_of(service) as planner:
        planner.stop()
    assert len(service.asked) == client.STOP_TRIES == 3


@pytest.mark.parametrize("away", [lost(httpx.ConnectError), lost(httpx.ConnectTimeout)])
def test_a_stop_that_cannot_be_sent_says_so(away: Answer) -> None:
    service = Answers(away)
    with planner_of(service) as planner, pytest.raises(UnreachableError, match="does not take the stop") as error:
        planner.stop()
    assert str(error.value).endswith("use the robot's own")
    assert len(service.asked) == client.STOP_TRIES


@pytest.mark.parametrize("tries", [[lost(httpx.ReadTimeout)], [lost(httpx.ReadError), lost()], [proxy(504)]])
def test_a_stop_that_was_sent_and_not_confirmed_says_so(tries: list[Answer]) -> None:
    service = Answers(*tries)
    with planner_of(service) as planner, pytest.raises(UnreachableError, match="sent and not confirmed") as error:
        planner.stop()
    assert "look whether the arm moves" in str(error.value)
    assert len(service.asked) == client.STOP_TRIES
