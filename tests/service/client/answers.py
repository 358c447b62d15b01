"""A service by its answers alone: for what a real one cannot be brought to in a test."""

import json
from collections.abc import Callable, Mapping
from typing import Any

import httpx

from service.client import Client
from service.problems.document import MEDIA_TYPE, problem_document

Answer = Callable[[httpx.Request], httpx.Response]

SERVICE = "http://cell"
SCAN = "/api/scans/20260101t000000-000000-00000000"


def events(*told: tuple[str, Mapping[str, Any]], between: str = "") -> Answer:
    """The scan's events, from the first number on; `between`: what comes on the stream before each."""
    lines = [
        f"{between}event: {name}\nid: {number}\ndata: {json.dumps(data)}\n\n"
        for number, (name, data) in enumerate(told, 1)
    ]
    return lambda _: httpx.Response(200, text="".join(lines), headers={"Content-Type": "text/event-stream"})


def refused(status: int, slug: str, **headers: str) -> Answer:
    document = problem_document(slug, "for now", SCAN, status=status)
    return lambda _: httpx.Response(status, json=document, headers={"Content-Type": MEDIA_TYPE} | headers)


def found(resource: Any, status: int = 200) -> Answer:
    return lambda _: httpx.Response(status, json=resource)


def proxy(status: int) -> Answer:
    """What a proxy says that does not reach the service."""
    return lambda _: httpx.Response(status, html="<h1>Bad Gateway</h1>")


def lost(kind: type[httpx.TransportError] = httpx.ConnectError) -> Answer:
    def answer(request: httpx.Request) -> httpx.Response:
        raise kind("no answer", request=request)

    return answer


class Answers(httpx.MockTransport):
    """One after the other, the last one for ever."""

    def __init__(self, *answers: Answer) -> None:
        super().__init__(self._answer)
        self._answers = answers
        self.asked: list[httpx.Request] = []

    def _answer(self, request: httpx.Request) -> httpx.Response:
        self.asked.append(request)
        return self._answers[min(len(self.asked), len(self._answers)) - 1](request)


def planner_of(answers: Answers) -> Client:
    """A client of a service that answers so."""
    planner = Client(SERVICE)
    planner.close()
    planner._http = httpx.Client(base_url=SERVICE, transport=answers)
    planner._stopping = httpx.Client(base_url=SERVICE, transport=answers)
    return planner
