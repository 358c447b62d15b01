"""A client follows a scan across short outages of the service."""

import time
from collections.abc import Callable
from typing import Any

import httpx2
import pytest

from pointchain_client import AnswerError, ProblemError, ScanProgress, UnreachableError, flows, retry
from pointchain_client.retry import RetryPolicy
from tests.service.client.answers import (
    KINDS,
    SCAN,
    SERVICE,
    Answer,
    ScriptedTransport,
    event_answer,
    json_answer,
    no_answer,
    planner_for,
    problem_answer,
    proxy_answer,
)


def scan(state: str, stage: str | None = None, fraction: float = 0.0) -> dict[str, Any]:
    """Return the members of a scan resource that the client reads."""
    return {
        "state": state,
        "progress": {"stage": stage, "fraction": fraction, "views": [], "elapsed_s": None, "remaining_s": None},
    }


ENDED = scan("succeeded", fraction=1.0)
ENDED_STREAM = event_answer(("scan", ENDED))


Follow = Callable[..., tuple[list[ScanProgress], int]]
"""Function of answers, and of `timeout_s`, that returns the reported progress and the number of requests."""


@pytest.fixture(params=KINDS)
def follow_answers(request: pytest.FixtureRequest) -> Follow:
    """Follow a scan through answers, by each kind of client."""

    def follow(*answers: Answer, timeout_s: float | None = None) -> tuple[list[ScanProgress], int]:
        service = ScriptedTransport(*answers)
        deadline = None if timeout_s is None else time.monotonic() + timeout_s
        seen: list[ScanProgress] = []
        with planner_for(request.param, service) as planner:
            planner._run(flows.follow(SCAN, RetryPolicy(SERVICE, SCAN, deadline)), seen.append)
        return seen, len(service.requests)

    return follow


@pytest.fixture(autouse=True)
def no_pauses(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(retry, "RETRY_INTERVAL_S", 0.01)


@pytest.mark.parametrize(
    "failure",
    [
        no_answer(),
        no_answer(httpx2.ReadTimeout),
        problem_answer(503, "not-ready"),
        problem_answer(503, "busy"),
        *map(proxy_answer, (502, 503, 504)),
    ],
)
@pytest.mark.parametrize(
    ("begin", "then"),
    [([], ENDED_STREAM), ([problem_answer(503, "too-many-streams")], json_answer(ENDED))],
    ids=["streamed", "polled"],
)
def test_the_client_waits_for_a_service_that_is_down_for_a_moment(
    follow_answers: Follow, begin: list[Answer], then: Answer, failure: Answer
) -> None:
    seen, requests = follow_answers(*begin, failure, failure, then)
    assert requests == len(begin) + 3
    assert [(progress.state, progress.fraction) for progress in seen] == [("succeeded", 1.0)]


@pytest.mark.parametrize("failure", [no_answer(), proxy_answer(502)])
def test_waiting_fails_when_the_service_stays_down(
    follow_answers: Follow, monkeypatch: pytest.MonkeyPatch, failure: Answer
) -> None:
    monkeypatch.setattr(retry, "MAX_OUTAGE_S", 0.05)
    with pytest.raises(UnreachableError, match="has not answered for"):
        follow_answers(failure)
    with pytest.raises(UnreachableError, match="has not answered for"):
        follow_answers(problem_answer(503, "too-many-streams"), failure)


@pytest.mark.parametrize("begin", [[], [problem_answer(503, "too-many-streams")]])
def test_waiting_ends_at_the_deadline(follow_answers: Follow, begin: list[Answer]) -> None:
    with pytest.raises(TimeoutError, match="and continues"):
        follow_answers(*begin, no_answer(), timeout_s=0.05)


def test_a_permanent_problem_is_raised_at_once(follow_answers: Follow) -> None:
    with pytest.raises(ProblemError) as unknown:
        follow_answers(problem_answer(404, "scan-not-found"), ENDED_STREAM)
    assert unknown.value.slug == "scan-not-found"
    with pytest.raises(UnreachableError, match="does not seem to be the service"):
        follow_answers(proxy_answer(500), ENDED_STREAM)


def test_only_changes_are_yielded(follow_answers: Follow) -> None:
    """Comments, `retry`, unknown events and repetitions yield nothing."""
    step = {"kind": "progress", "data": {"stage": "fusing", "fraction": 0.5}}
    stream = event_answer(
        ("scan", scan("processing")),
        ("progress", step),
        ("progress", step),
        ("news", {"kind": "news", "data": {}}),
        ("state", {"kind": "state", "data": {"state": "succeeded", "fraction": 1.0}}),
        between="retry: 2000\n\n: ping\n\n",
    )
    seen, _ = follow_answers(stream)
    assert [(progress.state, progress.fraction) for progress in seen] == [
        ("processing", 0.0),
        ("processing", 0.5),
        ("succeeded", 1.0),
    ]


def test_only_changes_are_yielded_while_polling(follow_answers: Follow) -> None:
    full, running = problem_answer(503, "too-many-streams"), json_answer(scan("processing"))
    seen, requests = follow_answers(full, running, full, running, full, running, full, json_answer(ENDED))
    assert requests == 8
    assert [progress.state for progress in seen] == ["processing", "succeeded"]


def test_a_repeated_stream_yields_nothing_twice(follow_answers: Follow) -> None:
    running = ("scan", scan("processing"))
    seen, _ = follow_answers(event_answer(running), event_answer(running), event_answer(running, ("resync", ENDED)))
    assert [progress.state for progress in seen] == ["processing", "succeeded"]


def test_a_state_of_a_newer_service_is_not_taken_as_the_end(follow_answers: Follow) -> None:
    connecting = {"kind": "state", "data": {"state": "connecting", "final": False}}
    kept = {"kind": "state", "data": {"state": "archived", "final": True}}
    seen, _ = follow_answers(event_answer(("scan", scan("queued")), ("state", connecting), ("state", kept)))
    assert [(progress.state, progress.ended) for progress in seen] == [
        ("queued", False),
        ("connecting", False),
        ("archived", True),
    ]


def test_an_event_that_is_none_of_the_service_is_an_error(follow_answers: Follow) -> None:
    with pytest.raises(AnswerError, match="progress is missing"):
        follow_answers(event_answer(("scan", {"state": "processing"})))
    with pytest.raises(AnswerError, match="member index must be an integer"):
        follow_answers(
            event_answer(
                ("scan", scan("scanning")), ("view", {"kind": "view", "data": {"index": "1", "state": "moving"}})
            )
        )


@pytest.mark.parametrize("error", [httpx2.ConnectError("of the callback"), StopIteration()])
@pytest.mark.parametrize("kind", KINDS)
def test_an_error_of_the_callback_reaches_the_caller(kind: str, error: Exception) -> None:
    service = ScriptedTransport(ENDED_STREAM)

    def fail(_: ScanProgress) -> None:
        raise error

    # a coroutine cannot raise StopIteration
    expected = RuntimeError if kind == "async" and isinstance(error, StopIteration) else type(error)
    with planner_for(kind, service) as planner, pytest.raises(expected):
        planner._run(flows.follow(SCAN, RetryPolicy(SERVICE, SCAN, None)), fail)
    assert len(service.requests) == 1
