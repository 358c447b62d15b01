"""A client of event streams for tests."""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import httpx2


@dataclass(frozen=True)
class ReceivedEvent:
    """An event as it was received."""

    kind: str
    id: str
    data: dict[str, Any]


@contextmanager
def open_stream(client: httpx2.Client, path: str, last: int | str | None = None) -> Iterator[Iterator[ReceivedEvent]]:
    """Yield an iterator over the events of a stream, after the event with the id `last` if it is given."""
    headers = {} if last is None else {"Last-Event-ID": str(last)}
    with client.sse(path, headers=headers) as source:
        assert source.response.status_code == 200, source.response.read()
        # A message with `retry` alone is not an event.
        yield (ReceivedEvent(one.event, one.id, json.loads(one.data)) for one in source if one.data)


def read_events(client: httpx2.Client, path: str, last: int | str | None = None) -> list[ReceivedEvent]:
    """Return all events of a stream that ends."""
    with open_stream(client, path, last) as events:
        return list(events)


def fold_events(events: list[ReceivedEvent]) -> dict[str, Any]:
    """Return the state that a client derives from events. The first event must have the complete scan."""
    known: dict[str, Any] = {}
    views: dict[int, Any] = {}
    for event in events:
        if event.kind in ("scan", "resync"):
            progress = event.data["progress"]
            known = {name: event.data[name] for name in ("state", "final", "problem", "summary")}
            known |= {name: progress[name] for name in ("stage", "fraction")}
            views = {view["index"]: view for view in progress["views"]}
        elif event.kind == "view":
            views[event.data["data"]["index"]] = event.data["data"]
        else:
            known |= event.data["data"]
    return known | {"views": views}
