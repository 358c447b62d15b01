"""Threads for what is asked for most: each answer is read and made in one go, by one of a few.

A plain `def` route goes through Starlette's threads once for each dependency, for itself and for the check of its
answer, and a file's once more for each piece: with many clients, threads that hand the interpreter to one another are
then most of the work.
"""

import asyncio
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextvars import copy_context

from pydantic import BaseModel
from starlette.responses import Response

THREADS = 4
"""More only get into each other's way: one reads while the others wait for the interpreter."""


class Reading:
    """The threads. Nothing that a stop waits for is done here."""

    def __init__(self) -> None:
        self._threads = ThreadPoolExecutor(THREADS, thread_name_prefix="reading")

    async def answer(self, read: Callable[[], Response]) -> Response:
        """What `read` gives, which may block; raises what it raises. For the event loop's thread."""
        # Not by anyio: its way there and back costs twice as much.
        return await asyncio.get_running_loop().run_in_executor(self._threads, copy_context().run, read)

    def close(self) -> None:
        """What has not begun is left out; returns when the rest has ended."""
        self._threads.shutdown(cancel_futures=True)


def json_answer(document: BaseModel) -> Response:
    """The document as FastAPI would send it, without its second check."""
    return Response(document.model_dump_json(), media_type="application/json")
