"""Scripted answers of a service, for failures that a real service does not show in a test."""

import asyncio
import json
from collections.abc import AsyncIterator, Callable, Mapping
from typing import Any, Self, cast

import httpx2

from pointchain_client import AsyncClient, Client
from service.problems.document import MEDIA_TYPE, problem_document

Answer = Callable[[httpx2.Request], httpx2.Response]

KINDS = ("sync", "async")
"""Kinds of clients."""
SERVICE = "http://cell"
SCAN = "/api/scans/20260101t000000-000000-00000000"


def event_answer(*contents: tuple[str, Mapping[str, Any]], between: str = "") -> Answer:
    """Return an event stream of a scan, numbered from 1, with the text `between` before each event."""
    lines = [
        f"{between}event: {name}\nid: {number}\ndata: {json.dumps(data)}\n\n"
        for number, (name, data) in enumerate(contents, 1)
    ]
    return lambda _: httpx2.Response(200, text="".join(lines), headers={"Content-Type": "text/event-stream"})


def problem_answer(status: int, slug: str, **headers: str) -> Answer:
    document = problem_document(slug, "for now", SCAN, status=status)
    return lambda _: httpx2.Response(status, json=document, headers={"Content-Type": MEDIA_TYPE} | headers)


def json_answer(resource: Any, status: int = 200) -> Answer:
    return lambda _: httpx2.Response(status, json=resource)


def proxy_answer(status: int) -> Answer:
    """Return the answer of a proxy that does not reach the service."""
    return lambda _: httpx2.Response(status, html="<h1>Bad Gateway</h1>")


def no_answer(kind: type[httpx2.TransportError] = httpx2.ConnectError) -> Answer:
    def answer(request: httpx2.Request) -> httpx2.Response:
        raise kind("no answer", request=request)

    return answer


class ScriptedTransport(httpx2.MockTransport):
    """Transport that gives the answers in order, and repeats the last one."""

    def __init__(self, *answers: Answer) -> None:
        super().__init__(self._answer)
        self._answers = answers
        self.requests: list[httpx2.Request] = []

    def _answer(self, request: httpx2.Request) -> httpx2.Response:
        self.requests.append(request)
        return self._answers[min(len(self.requests), len(self._answers)) - 1](request)


class BlockingAsyncClient:
    """An `AsyncClient` with blocking methods, so that one test checks both clients."""

    def __init__(self, planner: AsyncClient) -> None:
        self._planner = planner
        self._runner = asyncio.Runner()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._runner.run(self._planner.close())
        self._runner.close()

    def __getattr__(self, name: str) -> Callable[..., Any]:
        method = getattr(self._planner, name)

        def call(*arguments: Any, **options: Any) -> Any:
            result = method(*arguments, **options)
            return iter(self._items(result)) if isinstance(result, AsyncIterator) else self._runner.run(result)

        return call

    def _items(self, items: AsyncIterator[Any]) -> list[Any]:
        async def read() -> list[Any]:
            return [item async for item in items]

        return self._runner.run(read())


def open_planner(kind: str, address: str = SERVICE) -> Client:
    """Return a blocking client of a service.

    Args:
        kind: `sync` or `async`, the class under test.
        address: Address of the service.
    """
    return Client(address) if kind == "sync" else cast(Client, BlockingAsyncClient(AsyncClient(address)))


def planner_for(kind: str, answers: ScriptedTransport) -> Client:
    """Return a blocking client of a service that gives these answers. `kind` is `sync` or `async`."""
    if kind == "sync":
        planner = Client(SERVICE)
        planner.close()
        planner._http = httpx2.Client(base_url=SERVICE, transport=answers)
        planner._stopping = httpx2.Client(base_url=SERVICE, transport=answers)
        return planner
    scripted = AsyncClient(SERVICE)
    scripted._http = httpx2.AsyncClient(base_url=SERVICE, transport=answers)
    scripted._stopping = httpx2.AsyncClient(base_url=SERVICE, transport=answers)
    return cast(Client, BlockingAsyncClient(scripted))
