"""Client of the service for programs that use asyncio."""

import asyncio
import inspect
import os
from collections.abc import AsyncGenerator, AsyncIterator, Callable, Mapping
from contextlib import AsyncExitStack
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO, Self, TypeVar

import httpx2

from pointchain_client import flows
from pointchain_client.documents.cell import Cell, ScanValidation
from pointchain_client.documents.grasps import GraspList, HeightMap
from pointchain_client.documents.model import Changes, Model
from pointchain_client.documents.scans import Recording, Scan
from pointchain_client.flows import Method, ScanRef, Views
from pointchain_client.progress import ScanProgress
from pointchain_client.retry import CONNECT_TIMEOUT_S
from pointchain_client.steps import CloseEvents, Flow, NextEvent, OpenEvents, Pause, Request, RunningFlow

T = TypeVar("T")

CHUNK_BYTES = 1 << 18
"""Size of the parts in which a file is uploaded."""


class AsyncClient:
    """A connection to one service, for asyncio. Use it as an asynchronous context manager.

    The methods have the names, arguments, results and errors of `Client`. Call `stop` from another task than the one
    that waits for a scan. Cancelling a task ends its waiting, not the scan.

    Example:
        A scan, its model, and a grasp that the arm can carry out. `scan` moves the arm.

        >>> import asyncio
        >>> from pointchain_client import AsyncClient
        >>> async def plan(cell: AsyncClient) -> None:
        ...     model = await cell.model(await cell.scan(string_radius_m=0.0042, on_progress=print))
        ...     for grasp in (await cell.grasps(model)).reachable:
        ...         if model.trusted(grasp.chain) and grasp.reach.path_free:
        ...             if (await cell.release()).robot.at_home:  # your program may move the arm
        ...                 print(grasp.reach.q_pregrasp_rad, grasp.T_base_flange.grasp)  # (6,) and (4, 4), base frame
        ...             break
        >>> async def main() -> None:
        ...     async with AsyncClient("http://127.0.0.1:8000", token=None) as cell:
        ...         pass  # await plan(cell) with a service at this address
        >>> asyncio.run(main())
    """

    def __init__(self, address: str = "http://127.0.0.1:8000", token: str | None = None) -> None:
        """Create a client. No connection is made yet.

        Args:
            address: Address of the service.
            token: Token from `pointchain token add`. None: the service needs no token.

        Raises:
            ValueError: The address does not begin with `http://` or `https://`.
        """
        headers = flows.token_headers(token)
        timeout = httpx2.Timeout(flows.ANSWER_TIMEOUT_S, connect=CONNECT_TIMEOUT_S)
        self._service = flows.check_address(address)
        self._http = httpx2.AsyncClient(base_url=address, headers=headers, timeout=timeout)
        # separate, so that a running request never holds the connection that a stop needs
        self._stopping = httpx2.AsyncClient(base_url=address, headers=headers, timeout=flows.STOP_TIMEOUT_S)

    async def close(self) -> None:
        """Close the connections. A running scan continues."""
        await self._http.aclose()
        await self._stopping.aclose()

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self.close()

    # Scans

    async def scan(
        self,
        string_radius_m: float | None = None,
        method: Method = "graph",
        views: Views | None = None,
        all_grasps: bool = False,
        on_progress: Callable[[ScanProgress], object] | None = None,
        timeout_s: float | None = None,
    ) -> Scan:
        """Run a live scan and return it when it has a model. The arm moves, and may still be on its way home.

        Leaving early, by cancelling the task or `timeout_s`, does not stop the arm: call `stop`. `on_progress` may be a
        coroutine function. See `Client.scan` for the arguments and errors.
        """
        body = flows.live_request(string_radius_m, method, views, all_grasps)
        return await self._run(flows.start_and_wait(self._service, body, timeout_s), on_progress)

    async def replay(
        self,
        recording: str | os.PathLike[str],
        string_radius_m: float | None = None,
        method: Method = "graph",
        all_grasps: bool = False,
        on_progress: Callable[[ScanProgress], object] | None = None,
        timeout_s: float | None = None,
    ) -> Scan:
        """Recognise a recording and return the scan when it has a model. Nothing moves. See `Client.replay`."""
        recording_id = (await self.upload(recording)).id if isinstance(recording, os.PathLike) else recording
        body = flows.replay_request(recording_id, string_radius_m, method, all_grasps)
        return await self._run(flows.start_and_wait(self._service, body, timeout_s), on_progress)

    async def reprocess(
        self,
        scan: ScanRef,
        request: Mapping[str, Any] | None = None,
        on_progress: Callable[[ScanProgress], object] | None = None,
        timeout_s: float | None = None,
    ) -> Scan:
        """Recognise the recording of a scan again. Nothing moves. See `Client.reprocess`."""
        return await self._run(flows.reprocess(self._service, scan, request or {}, timeout_s), on_progress)

    async def start(self, request: Mapping[str, Any], key: str | None = None) -> Scan:
        """Start a scan and return it without waiting for its end. See `Client.start`."""
        return await self._run(flows.start(self._service, request, key))

    async def validate(self, request: Mapping[str, Any]) -> ScanValidation:
        """Check a request for a scan without starting one. Nothing moves. See `Client.validate`."""
        return await self._run(flows.validate(self._service, request))

    async def wait(
        self,
        scan: Scan | str,
        on_progress: Callable[[ScanProgress], object] | None = None,
        timeout_s: float | None = None,
    ) -> Scan:
        """Wait until a scan has a model, and return it. See `Client.wait`."""
        return await self._run(flows.wait(self._service, scan, timeout_s), on_progress)

    async def get(self, scan_id: str) -> Scan:
        """Return a scan in its present state. See `Client.get`."""
        return await self._run(flows.get_scan(self._service, scan_id))

    async def scans(self, **filters: Any) -> AsyncIterator[Scan]:
        """Yield the scans, the newest first. Further pages are read when they are needed. See `Client.scans`."""
        page = await self._run(flows.scan_page(self._service, flows.SCANS, filters))
        for scan in page.scans:
            yield scan
        while page.next is not None:
            page = await self._run(flows.scan_page(self._service, page.next, {}))
            for scan in page.scans:
                yield scan

    async def model(self, scan: Scan | str, since: ScanRef | None = None) -> Model:
        """Return the model of a scan as arrays. See `Client.model`."""
        return await self._run(flows.model(self._service, scan, since))

    async def grasps(
        self,
        scan: ScanRef,
        chain: int | None = None,
        s_range_m: tuple[float | None, float | None] | None = None,
        min_clearance_m: float | None = None,
        reachable: bool | None = None,
        reach: bool | None = None,
        count: int | None = None,
    ) -> GraspList:
        """Return the grasps of a scan with their reach. See `Client.grasps`."""
        filters = flows.grasp_filters(chain, s_range_m, min_clearance_m, reachable, reach, count)
        return await self._run(flows.grasps(self._service, scan, filters))

    async def height_map(self, scan: ScanRef) -> HeightMap:
        """Return the height of the table and of all that lies on it. See `Client.height_map`."""
        return await self._run(flows.height_map(self._service, scan))

    async def changes(self, scan: ScanRef, since: ScanRef) -> Changes:
        """Return which chain of an earlier scan is which chain of this one. See `Client.changes`."""
        return await self._run(flows.changes(self._service, scan, since))

    async def keep(self, scan: ScanRef, kept: bool = True) -> Scan:
        """Protect a scan and its recording from removal, or end the protection. See `Client.keep`."""
        return await self._run(flows.keep(self._service, scan, kept))

    async def delete(self, scan: ScanRef) -> None:
        """Remove a scan that has ended, with its results. See `Client.delete`."""
        await self._run(flows.delete(self._service, scan))

    async def upload(self, recording: str | os.PathLike[str]) -> Recording:
        """Upload a recording under the name of its file. See `Client.upload`."""
        with await asyncio.to_thread(Path(recording).open, "rb") as file:
            return await self._run(flows.upload(self._service, file, recording))

    # The cell

    async def cell(self) -> Cell:
        """Return the last known state of the cell. See `Client.cell`."""
        return await self._run(flows.get_cell(self._service))

    async def stop(self) -> None:
        """Stop the arm at once. A running scan is aborted. This is not an emergency stop. See `Client.stop`."""
        await self._run(flows.stop(self._service))

    async def cancel(self, scan: ScanRef) -> Scan:
        """Stop one scan, the arm first, and return the scan when it has ended. See `Client.cancel`."""
        return await self._run(flows.cancel(self._service, scan))

    async def connect(self) -> Cell:
        """Connect arm and camera, and return the cell. Nothing moves. See `Client.connect`."""
        return await self._run(flows.connect(self._service))

    async def release(self) -> Cell:
        """Wait until the arm is home and release it, so that another program can move it. See `Client.release`."""
        return await self._run(flows.release(self._service))

    async def acknowledge(self) -> None:
        """Acknowledge a fault, after a person has inspected the cell and says so. See `Client.acknowledge`."""
        await self._run(flows.acknowledge(self._service))

    async def _run(self, flow: Flow[T], on_progress: Callable[[ScanProgress], object] | None = None) -> T:
        """Carry out the steps of a flow and return its result."""
        async with _Connection(self._http, self._stopping) as connection:
            running = RunningFlow(flow)
            while (step := running.step) is not None:
                # outside `try`: an error of the callback belongs to the caller
                if isinstance(step, ScanProgress):
                    if on_progress is not None:
                        reported = on_progress(step)
                        if inspect.isawaitable(reported):
                            await reported
                    running.resume(None)
                    continue
                try:
                    result = await connection.carry_out(step)
                except httpx2.RequestError as error:
                    running.fail(error)
                else:
                    running.resume(result)
            return running.result


class _Connection:
    """Carries out the steps of one flow, which has at most one open stream of events."""

    def __init__(self, http: httpx2.AsyncClient, stopping: httpx2.AsyncClient) -> None:
        self._http, self._stopping = http, stopping
        self._stream = AsyncExitStack()
        self._events: AsyncIterator[httpx2.ServerSentEvent] | None = None

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *_: object) -> None:
        await self._close_events()

    async def carry_out(self, step: Request | OpenEvents | NextEvent | CloseEvents | Pause) -> Any:
        """Carry out a step and return its result."""
        match step:
            case Request():
                http = self._stopping if step.is_stop else self._http
                content = None if step.upload is None else _chunks(step.upload)
                return await http.request(**flows.request_arguments(step), content=content)
            case OpenEvents():
                source = await self._stream.enter_async_context(
                    self._http.sse(step.path, headers=step.headers, timeout=step.timeout)
                )
                if not source.response.is_success:
                    await source.response.aread()
                self._events = aiter(source)
                return source.response
            case NextEvent():
                return None if self._events is None else await anext(self._events, None)
            case CloseEvents():
                return await self._close_events()
            case Pause():
                return await asyncio.sleep(step.seconds)

    async def _close_events(self) -> None:
        events, self._events = self._events, None
        try:
            if isinstance(events, AsyncGenerator):
                await events.aclose()  # before its response, so that no generator is left to the event loop
        finally:
            await self._stream.aclose()


async def _chunks(file: BinaryIO) -> AsyncIterator[bytes]:
    """Yield the content of a file, read by another thread."""
    while chunk := await asyncio.to_thread(file.read, CHUNK_BYTES):
        yield chunk
