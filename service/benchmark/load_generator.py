"""Load a service with many clients at once, for `pointchain bench`.

The load has its own process, so that its work does not slow the service. It needs the standard library only.

    python -m service.benchmark.load_generator '{"port": 8000, "connections": 8, "requests": [...], "streams": [...]}'

It sends requests until its stdin ends, and then prints its results on stdout, as one JSON document.
"""

import asyncio
import gc
import itertools
import json
import socket
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from typing import Any

from cell.process.python_process import end_process, start_python

HOST = "127.0.0.1"
HEAD_END = b"\r\n\r\n"
RETRY_AFTER_S = 5.0
"""Time after which a refused client requests the event stream again, as the Retry-After of the service says."""
STALLED_BYTES = 4096
"""Size of the receive buffer of a client that never reads."""


@dataclass(frozen=True)
class LoadRequest:
    """A request that is sent again and again."""

    name: str
    """Name of its kind, for the results."""
    path: str
    status: int = 200
    """The expected status."""
    etag: str | None = None
    """ETag of the copy that the client holds. None: it holds none."""

    def request(self, port: int) -> bytes:
        """Return the bytes of the request."""
        condition = "" if self.etag is None else f"If-None-Match: {self.etag}\r\n"
        return f"GET {self.path} HTTP/1.1\r\nHost: {HOST}:{port}\r\n{condition}\r\n".encode()


@dataclass(frozen=True)
class Load:
    """The requests and the number of clients."""

    port: int
    connections: int
    """Number of clients. Each sends one request after the other."""
    requests: Sequence[LoadRequest]
    pause_s: float = 0.0
    """Time between an answer and the next request."""
    streams: int = 0
    """Number of further clients that request the event stream. Every other one never reads."""
    stream_path: str = "/api/events"

    def to_json(self) -> str:
        """Return the load as JSON, for the other process."""
        return json.dumps(asdict(self))

    @staticmethod
    def from_json(text: str) -> "Load":
        """Return the load that `to_json` wrote."""
        values = json.loads(text)
        return Load(**values | {"requests": [LoadRequest(**one) for one in values["requests"]]})


@dataclass
class LoadResults:
    """Results of all clients."""

    seconds: dict[str, list[float]] = field(default_factory=dict)
    """Time from each request to the end of its answer, by kind."""
    wrong: list[str] = field(default_factory=list)
    """Unexpected answers and lost connections."""
    let_in: int = 0
    """Number of event streams that the service accepted."""
    refused: int = 0
    """Number of event streams that the service refused."""
    news_bytes: int = 0
    """Bytes that the reading clients received from their event streams."""


class LoadClient(asyncio.Protocol):
    """One client. It sends the next request when the last answer is complete."""

    def __init__(
        self, load: Load, requests: Iterator[LoadRequest], results: LoadResults, ending: asyncio.Event
    ) -> None:
        self._load, self._requests, self._results, self._ending = load, requests, results, ending
        self._received, self._answer_bytes = b"", 0
        self._requested_s = 0.0

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Send the first request."""
        assert isinstance(transport, asyncio.Transport)
        self._transport = transport
        self._send_next()

    def data_received(self, data: bytes) -> None:
        """Collect an answer; when it is complete, note its time and send the next request."""
        self._received += data
        if not self._answer_bytes:
            end = self._received.find(HEAD_END)
            if end < 0:
                return
            self._answer_bytes = end + len(HEAD_END) + content_length(self._received[:end])
        if len(self._received) < self._answer_bytes:
            return
        if self._ending.is_set():  # the results are final
            self._transport.close()
            return
        self._results.seconds.setdefault(self._request.name, []).append(time.perf_counter() - self._requested_s)
        status = int(self._received[9:12])
        if status != self._request.status:
            self._results.wrong.append(f"{self._request.path}: {status} instead of {self._request.status}")
        if self._load.pause_s > 0:
            asyncio.get_running_loop().call_later(self._load.pause_s, self._send_next)
        else:
            self._send_next()

    def connection_lost(self, exc: Exception | None) -> None:
        """Note a lost connection, unless the load is ending."""
        if not self._ending.is_set():
            self._results.wrong.append(f"{self._request.path}: the connection was lost")

    def _send_next(self) -> None:
        if self._transport.is_closing():
            return
        self._received, self._answer_bytes = b"", 0
        self._request = next(self._requests)
        self._requested_s = time.perf_counter()
        self._transport.write(self._request.request(self._load.port))


def content_length(head: bytes) -> int:
    """Return the Content-Length of the head of an answer; 0 if it has none."""
    _, found, rest = head.lower().partition(b"\r\ncontent-length:")
    return int(rest.split(b"\r\n", 1)[0]) if found else 0


async def follow_events(load: Load, results: LoadResults, reading: bool) -> None:
    """Request the event stream, and request it again after it was refused or has ended.

    Args:
        load: The load.
        results: Results, to which this client adds its own.
        reading: Whether the client reads the events. If not, it reads the head of the answer only.
    """
    loop = asyncio.get_running_loop()
    request = LoadRequest("events", load.stream_path).request(load.port)
    while True:
        connection = socket.socket()
        if not reading:
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, STALLED_BYTES)
        connection.setblocking(False)
        with connection:
            await loop.sock_connect(connection, (HOST, load.port))
            await loop.sock_sendall(connection, request)
            head = await loop.sock_recv(connection, 512)
            if head[9:12] == b"200":
                results.let_in += 1
                await _read_stream(connection, results, reading)
            elif head[9:12] == b"503":
                results.refused += 1
            else:
                results.wrong.append(f"{load.stream_path}: {head[:12]!r}")
        await asyncio.sleep(RETRY_AFTER_S)


async def _read_stream(connection: socket.socket, results: LoadResults, reading: bool) -> None:
    if not reading:
        await asyncio.Event().wait()
    while data := await asyncio.get_running_loop().sock_recv(connection, 1 << 16):
        results.news_bytes += len(data)


async def run(load: Load) -> dict[str, Any]:
    """Send requests until stdin ends, and return the results."""
    loop, results, ending = asyncio.get_running_loop(), LoadResults(), asyncio.Event()
    followers = [asyncio.create_task(follow_events(load, results, number % 2 == 0)) for number in range(load.streams)]
    begin = time.perf_counter()
    for number in range(load.connections):
        # each client begins with another request, so that they do not all send the same one at once.
        requests = itertools.islice(itertools.cycle(load.requests), number, None)
        await loop.create_connection(
            lambda requests=requests: LoadClient(load, requests, results, ending), HOST, load.port
        )
    await asyncio.to_thread(sys.stdin.read)
    ending.set()
    seconds = time.perf_counter() - begin
    for task in followers:
        task.cancel()
    broken = [error for error in await asyncio.gather(*followers, return_exceptions=True) if isinstance(error, OSError)]
    results.wrong += [f"{load.stream_path}: {error}" for error in broken]
    return vars(results) | {"duration_s": seconds}


@contextmanager
def run_load(load: Load) -> Iterator[dict[str, Any]]:
    """Run the load inside the `with` block, and yield a dictionary that holds the results after the block."""
    results: dict[str, Any] = {}
    process = start_python("-m", __name__, load.to_json(), stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    try:
        yield results
        results |= json.loads(process.communicate()[0])
    finally:
        end_process(process)


if __name__ == "__main__":
    gc.disable()  # its pauses would count as those of the service
    print(json.dumps(asyncio.run(run(Load.from_json(sys.argv[1])))))
