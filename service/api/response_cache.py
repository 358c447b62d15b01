"""Cache of the most frequent responses, filled by a few threads of its own.

A plain `def` route passes through Starlette's threads once for each dependency, once for itself, once for the check of
its response, and for a file once more for each chunk. With many clients, most of the work is then threads that hand the
interpreter to one another. Even one round trip to a thread takes longer than all the rest. With 16 clients and
without kept entries, the service sent a third as many answers per second.
"""

import asyncio
import time
from collections import OrderedDict
from collections.abc import Callable, Hashable
from concurrent.futures import ThreadPoolExecutor
from contextvars import copy_context
from dataclasses import dataclass
from typing import Any, TypeVar

from pydantic import BaseModel
from starlette.responses import Response

from service.storage.database import Database

T = TypeVar("T")

THREADS = 4
"""Number of reading threads. More would only wait for the interpreter."""
MAX_AGE_S = 0.5
"""Age after which an entry is read again, so that changes from outside the service, such as a deleted file, are seen.

Changes by the service itself are seen at once.
"""
MAX_ENTRIES = 64
"""Number of entries that are kept, and that were requested within `MAX_AGE_S`."""
MAX_ENTRY_BYTES = 1 << 18
"""Size of the largest response that is kept."""


@dataclass(frozen=True)
class _Entry:
    future: "asyncio.Future[Any]"
    """The value, once it is read. Many requests share it, so it is never changed."""
    change: object
    """The last change of the database before the value was read."""
    requested_at: float
    """Time of the first request, in seconds of `time.monotonic()`."""


class ResponseCache:
    """A cache with its own threads, for use in the event loop's thread. Stops do not pass through it."""

    def __init__(self, database: Database) -> None:
        self._database = database
        self._entries: OrderedDict[Hashable, _Entry] = OrderedDict()
        self._threads = ThreadPoolExecutor(THREADS, thread_name_prefix="response-cache")

    async def respond(self, key: Hashable, read: Callable[[], Response]) -> Response:
        """Return the cached response for `key`, or the one that `read` returns if something may have changed.

        Args:
            key: As for `get`.
            read: Makes the response. It may block. Its exceptions reach the caller.
        """
        response = await self.get(key, read)
        if int(response.headers.get("content-length", "0")) > MAX_ENTRY_BYTES:
            self._entries.pop(key, None)
        return response

    async def get(self, key: Hashable, read: Callable[[], T]) -> T:
        """Return the cached value for `key`, or the one that `read` returns if something may have changed.

        Requests for a key that is just being read wait for the same value.

        Args:
            key: Names everything that the value depends on, apart from the database and files.
            read: Makes the value. It may block. Its exceptions reach the caller.
        """
        now_s, change = time.monotonic(), self._database.change
        entry = self._entries.get(key)
        if entry is None or entry.change is not change or now_s - entry.requested_at > MAX_AGE_S:
            self._drop_expired(now_s)
            # not through anyio, whose round trip takes twice as long
            future = asyncio.get_running_loop().run_in_executor(self._threads, copy_context().run, read)
            entry = self._entries[key] = _Entry(future, change, now_s)
            self._entries.move_to_end(key)
            if len(self._entries) > MAX_ENTRIES:
                self._entries.popitem(last=False)
        try:
            # shielded, because the first client may disconnect while others wait for the same value
            return entry.future.result() if entry.future.done() else await asyncio.shield(entry.future)
        except BaseException:
            if self._entries.get(key) is entry:
                del self._entries[key]  # the next request tries again
            raise

    def _drop_expired(self, now_s: float) -> None:
        """Drop the expired entries, which would otherwise stay until as many others are read."""
        # each entry is moved to the end when it is made, so the oldest come first
        while self._entries and now_s - next(iter(self._entries.values())).requested_at > MAX_AGE_S:
            self._entries.popitem(last=False)

    def close(self) -> None:
        """Cancel the reads that have not begun, and return when the others have ended."""
        self._threads.shutdown(cancel_futures=True)


def json_response(document: BaseModel, headers: dict[str, str] | None = None) -> Response:
    """Return the document as FastAPI would send it, without validating it a second time."""
    return Response(document.model_dump_json(by_alias=True), media_type="application/json", headers=headers)
