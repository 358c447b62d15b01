"""What is asked for most: answered from memory while nothing has changed, else read by one of a few threads.

A plain `def` route goes through Starlette's threads once for each dependency, for itself and for the check of its
answer, and a file's once more for each piece: with many clients, threads that hand the interpreter to one another are
then most of the work. Even one way to a thread and back is more than all the rest.
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
"""More only get into each other's way: one reads while the others wait for the interpreter."""
FRESH_S = 0.5
"""So long something is known without looking again: whatever else than the service may change it, as a person who takes
a file away, is seen by then. What the service changes is seen at once."""
REMEMBERED = 64
"""So many are known at a time ..."""
SMALL_BYTES = 1 << 18
"""... and no answer that is larger."""


@dataclass(frozen=True)
class _Known:
    coming: "asyncio.Future[Any]"
    """What is known, once it is read: never changed, so that it can be given to many."""
    change: object
    """The database's last one before."""
    asked_s: float
    """`time.monotonic()`."""


class Reading:
    """The memory and the threads. Nothing that a stop waits for is done here. Belongs to the event loop's thread."""

    def __init__(self, database: Database) -> None:
        self._database = database
        self._known: OrderedDict[Hashable, _Known] = OrderedDict()
        self._threads = ThreadPoolExecutor(THREADS, thread_name_prefix="reading")

    async def answer(self, to: Hashable, read: Callable[[], Response]) -> Response:
        """The answer that `read` gives, which may block; the last one to the same, where nothing has changed since.

        Raises what `read` raises.
        """
        answer = await self.known(to, read)
        if int(answer.headers.get("content-length", "0")) > SMALL_BYTES:
            self._known.pop(to, None)
        return answer

    async def known(self, what: Hashable, read: Callable[[], T]) -> T:
        """The same of anything that depends on the database and on files alone; whatever else it depends on must be
        part of `what`. Who asks for what is just being read waits for that."""
        now_s, change = time.monotonic(), self._database.change
        known = self._known.get(what)
        if known is None or known.change is not change or now_s - known.asked_s > FRESH_S:
            # Not by anyio: its way there and back costs twice as much.
            coming = asyncio.get_running_loop().run_in_executor(self._threads, copy_context().run, read)
            known = self._known[what] = _Known(coming, change, now_s)
            self._known.move_to_end(what)
            if len(self._known) > REMEMBERED:
                self._known.popitem(last=False)
        try:
            # Whoever has asked first may leave before the others have their answer.
            return known.coming.result() if known.coming.done() else await asyncio.shield(known.coming)
        except BaseException:
            if self._known.get(what) is known:
                del self._known[what]  # the next one tries it again
            raise

    def close(self) -> None:
        """What has not begun is left out; returns when the rest has ended."""
        self._threads.shutdown(cancel_futures=True)


def json_answer(document: BaseModel) -> Response:
    """The document as FastAPI would send it, without its second check."""
    return Response(document.model_dump_json(), media_type="application/json")
