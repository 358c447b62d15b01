"""Following a scan past a service that is away for a moment."""

import json
from collections.abc import Callable

import httpx
import pytest

from service.client import ProblemError, ScanProgress, UnreachableError
from service.client import progress as progress_module
from service.client.progress import follow
from service.problems import MEDIA_TYPE, problem_document

ADDRESS = "/api/scans/20260101t000000-000000-00000000"
ENDED = {"state": "succeeded", "progress": {"stage": None, "fraction": 1.0, "views": []}}


def told(_: httpx.Request) -> httpx.Response:
    event = f"event: scan\nid: 1\ndata: {json.dumps(ENDED)}\n\n"
    return httpx.Response(200, text=event, headers={"Content-Type": "text/event-stream"})


def refused(status: int, slug: str) -> Callable[[httpx.Request], httpx.Response]:
    document = problem_document(status, slug, "for now", ADDRESS)
    return lambda _: httpx.Response(status, json=document, headers={"Content-Type": MEDIA_TYPE})


def lost(request: httpx.Request) -> httpx.Response:
    raise httpx.ConnectError("nobody listens", request=request)


def followed(*answers: Callable[[httpx.Request], httpx.Response]) -> tuple[list[ScanProgress], int]:
    """What a service gives to be seen that answers one request after the other so, the last one for ever; and how
    many it needed."""
    asked = 0

    def answer(request: httpx.Request) -> httpx.Response:
        nonlocal asked
        asked += 1
        return answers[min(asked, len(answers)) - 1](request)

    with httpx.Client(base_url="http://cell", transport=httpx.MockTransport(answer)) as http:
        return list(follow(http, ADDRESS, None)), asked


@pytest.fixture(autouse=True)
def at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(progress_module, "AGAIN_S", 0.01)


@pytest.mark.parametrize("away", [lost, refused(503, "not-ready"), refused(503, "busy")])
def test_a_service_that_is_away_for_a_moment_is_waited_for(away: Callable[[httpx.Request], httpx.Response]) -> None:
    seen, asked = followed(away, away, told)
    assert asked == 3
    assert [(progress.state, progress.fraction) for progress in seen] == [("succeeded", 1.0)]


@pytest.mark.parametrize("away", [lost, refused(503, "not-ready")])
def test_also_where_the_scan_is_only_looked_at(away: Callable[[httpx.Request], httpx.Response]) -> None:
    seen, asked = followed(refused(503, "too-many-streams"), away, told)
    assert asked == 3
    assert seen[-1].ended


def test_one_that_stays_away_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(progress_module, "LOST_S", 0.05)
    with pytest.raises(UnreachableError, match="has not answered for"):
        followed(lost)


def test_a_refusal_for_good_is_raised_at_once() -> None:
    with pytest.raises(ProblemError) as unknown:
        followed(refused(404, "scan-not-found"), told)
    assert unknown.value.slug == "scan-not-found"
