"""Following a scan past a service that is away for a moment."""

import time
from typing import Any

import httpx
import pytest

from service.client import ProblemError, ScanProgress, UnreachableError
from service.client import retry as patience
from service.client.progress import follow
from service.client.retry import Patience
from tests.service.client.answers import SCAN, SERVICE, Answer, Answers, events, found, lost, proxy, refused


def scan(state: str, stage: str | None = None, fraction: float = 0.0) -> dict[str, Any]:
    """What is read of the scan's resource."""
    return {"state": state, "progress": {"stage": stage, "fraction": fraction, "views": []}}


ENDED = scan("succeeded", fraction=1.0)
told = events(("scan", ENDED))


def followed(*answers: Answer, timeout_s: float | None = None) -> tuple[list[ScanProgress], int]:
    """What a service gives to be seen that answers so; and how many answers it needed."""
    service = Answers(*answers)
    with httpx.Client(base_url=SERVICE, transport=service) as http:
        deadline = None if timeout_s is None else time.monotonic() + timeout_s
        return list(follow(http, SCAN, Patience(http, SCAN, deadline))), len(service.asked)


@pytest.fixture(autouse=True)
def at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(patience, "AGAIN_S", 0.01)


@pytest.mark.parametrize(
    "away",
    [
        lost(),
        lost(httpx.ReadTimeout),
        refused(503, "not-ready"),
        refused(503, "busy"),
        *map(proxy, (502, 503, 504)),
    ],
)
@pytest.mark.parametrize(
    ("begin", "then"), [([], told), ([refused(503, "too-many-streams")], found(ENDED))], ids=["followed", "looked at"]
)
def test_a_service_that_is_away_for_a_moment_is_waited_for(begin: list[Answer], then: Answer, away: Answer) -> None:
    seen, asked = followed(*begin, away, away, then)
    assert asked == len(begin) + 3
    assert [(progress.state, progress.fraction) for progress in seen] == [("succeeded", 1.0)]


@pytest.mark.parametrize("away", [lost(), proxy(502)])
def test_one_that_stays_away_is_given_up(monkeypatch: pytest.MonkeyPatch, away: Answer) -> None:
    monkeypatch.setattr(patience, "LOST_S", 0.05)
    with pytest.raises(UnreachableError, match="has not answered for"):
        followed(away)
    with pytest.raises(UnreachableError, match="has not answered for"):
        followed(refused(503, "too-many-streams"), away)


@pytest.mark.parametrize("begin", [[], [refused(503, "too-many-streams")]])
def test_nobody_waits_beyond_the_deadline(begin: list[Answer]) -> None:
    with pytest.raises(TimeoutError, match="goes on"):
        followed(*begin, lost(), timeout_s=0.05)


def test_a_refusal_for_good_is_raised_at_once() -> None:
    with pytest.raises(ProblemError) as unknown:
        followed(refused(404, "scan-not-found"), told)
    assert unknown.value.slug == "scan-not-found"
    with pytest.raises(UnreachableError, match="does not seem to be the service"):
        followed(proxy(500), told)


def test_only_what_has_changed_is_told() -> None:
    """Whatever else is on the stream: comments, the time to come again, news of what is not known, the same again."""
    step = {"kind": "progress", "data": {"stage": "fusing", "fraction": 0.5}}
    stream = events(
        ("scan", scan("processing")),
        ("progress", step),
        ("progress", step),
        ("news", {"kind": "news", "data": {}}),
        ("state", {"kind": "state", "data": {"state": "succeeded", "fraction": 1.0}}),
        between="retry: 2000\n\n: ping\n\n",
    )
    seen, _ = followed(stream)
    assert [(progress.state, progress.fraction) for progress in seen] == [
        ("processing", 0.0),
        ("processing", 0.5),
        ("succeeded", 1.0),
    ]


def test_also_where_the_scan_is_only_looked_at() -> None:
    full, running = refused(503, "too-many-streams"), found(scan("processing"))
    seen, asked = followed(full, running, full, running, full, running, full, found(ENDED))
    assert asked == 8
    assert [progress.state for progress in seen] == ["processing", "succeeded"]


def test_a_stream_that_begins_anew_tells_nothing_twice() -> None:
    running = ("scan", scan("processing"))
    seen, _ = followed(events(running), events(running), events(running, ("resync", ENDED)))
    assert [progress.state for progress in seen] == ["processing", "succeeded"]
