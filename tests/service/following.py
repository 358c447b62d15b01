"""A client of event streams, for tests."""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import httpx2


@dataclass(frozen=True)
class Told:
    """One event as it came."""

    kind: str
    id: str
    data: dict[str, Any]


@contextmanager
def following(client: httpx2.Client, path: str, last: int | str | None = None) -> Iterator[Iterator[Told]]:
    """The events of a stream as they come; behind the event `last`, if given."""
    headers = {} if last is None else {"Last-Event-ID": str(last)}
    with client.sse(path, headers=headers) as source:
        assert source.response.status_code == 200, source.response.read()
        # `retry` alone is no event.
        yield (Told(one.event, one.id, json.loads(one.data)) for one in source if one.data)


def told(client: httpx2.Client, path: str, last: int | str | None = None) -> list[Told]:
    """All events of a stream that ends."""
    with following(client, path, last) as events:
        return list(events)


def folded(events: list[Told]) -> dict[str, Any]:
    """What a client makes of the events, the first of which is the whole scan: all that events tell of it."""
    known: dict[str, Any] = {}
    views: dict[int, Any] = {}
    for event in events:
        if event.kind in ("scan", "resync"):
            progress = event.data["progress"]
            known = {name: event.data[name] for name in ("state", "problem", "summary")}
            known |= {name: progress[name] for name in ("stage", "fraction")}
            views = {view["index"]: view for view in progress["views"]}
        elif event.kind == "view":
            views[event.data["data"]["index"]] = event.data["data"]
        else:
            known |= event.data["data"]
    return known | {"views": views}
