"""Client of the service, for programs that plan with its models.

The client never requests a motion twice by itself. If an answer is lost, `UnansweredError` has the request and the key
with which `start` finds the scan, or starts it if it was not started.
"""

import os
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import Any, Self, TypeVar

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


class Client:
    """A connection to one service. Use it as a context manager.

    All methods may be called from several threads. Call `stop` from another thread than the one that waits for a scan.

    Example:
        A scan, its model, and a grasp that the arm can carry out. `scan` moves the arm.

        >>> from pointchain_client import Client
        >>> def plan(cell: Client) -> None:
        ...     scan = cell.scan(string_radius_m=0.0042, on_progress=print)
        ...     model = cell.model(scan)
        ...     for grasp in cell.grasps(scan).reachable:
        ...         if model.trusted(grasp.chain) and grasp.reach.path_free:
        ...             if cell.release().robot.at_home:  # your program may move the arm
        ...                 print(grasp.reach.q_pregrasp_rad, grasp.T_base_flange.grasp)  # (6,) and (4, 4), base frame
        ...             break
        >>> with Client("http://127.0.0.1:8000", token=None) as cell:
        ...     pass  # plan(cell) with a service at this address
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
        self._http = httpx2.Client(base_url=address, headers=headers, timeout=timeout)
        # separate, so that a running request never holds the connection that a stop needs
        self._stopping = httpx2.Client(base_url=address, headers=headers, timeout=flows.STOP_TIMEOUT_S)

    def close(self) -> None:
        """Close the connections. A running scan continues."""
        self._http.close()
        self._stopping.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    # Scans

    def scan(
        self,
        string_radius_m: float | None = None,
        method: Method = "graph",
        views: Views | None = None,
        all_grasps: bool = False,
        on_progress: Callable[[ScanProgress], object] | None = None,
        timeout_s: float | None = None,
    ) -> Scan:
        """Run a live scan and return it when it has a model. The arm moves, and may still be on its way home.

        Leaving early, by Ctrl-C or `timeout_s`, does not stop the arm: call `stop`.

        Args:
            string_radius_m: Radius of the string, metres. None: the radius of the cell's configuration, or measured.
            method: Recognition method.
            views: Number of viewpoints, or `auto`: four, and four more only if something is doubtful. None: as
                configured.
            all_grasps: Whether the model also has the grasps on parts of strings with a doubt.
            on_progress: Called with each change of the scan.
            timeout_s: Time limit, seconds. None: no limit.

        Returns:
            The scan, with the state `succeeded` or `partial`.

        Raises:
            ProblemError: The scan was not accepted. Nothing moved.
            ScanFailedError: The scan ended without a model. The error has the reason.
            UnansweredError: The answer was lost. The scan may have been started.
            UnreachableError: The service cannot be reached.
            NotEndedError: The scan has not ended within the time limit. It continues.
        """
        body = flows.live_request(string_radius_m, method, views, all_grasps)
        return self._run(flows.start_and_wait(self._service, body, timeout_s), on_progress)

    def replay(
        self,
        recording: str | os.PathLike[str],
        string_radius_m: float | None = None,
        method: Method = "graph",
        all_grasps: bool = False,
        on_progress: Callable[[ScanProgress], object] | None = None,
        timeout_s: float | None = None,
    ) -> Scan:
        """Recognise a recording and return the scan when it has a model. Nothing moves.

        Args:
            recording: Id of a recording that the service has, or the path of a file, which is uploaded at each call. A
                path is a `pathlib.Path` or another `os.PathLike`; a `str` is always an id.
            string_radius_m: Radius of the string, metres. None: the radius in the recording, or measured.
            method: Recognition method.
            all_grasps: Whether the model also has the grasps on parts of strings with a doubt.
            on_progress: Called with each change of the scan.
            timeout_s: Time limit, seconds. None: no limit.

        Returns:
            The scan, with the state `succeeded` or `partial`.

        Raises:
            ValueError: The text is not the id of a recording.
            ProblemError: The recording or the scan was not accepted.
            ScanFailedError: The scan ended without a model. The error has the reason.
            UnansweredError: The answer was lost. The scan may have been started.
            UnreachableError: The service cannot be reached.
            NotEndedError: The scan has not ended within the time limit. It continues.
        """
        recording_id = self.upload(recording).id if isinstance(recording, os.PathLike) else recording
        body = flows.replay_request(recording_id, string_radius_m, method, all_grasps)
        return self._run(flows.start_and_wait(self._service, body, timeout_s), on_progress)

    def reprocess(
        self,
        scan: ScanRef,
        request: Mapping[str, Any] | None = None,
        on_progress: Callable[[ScanProgress], object] | None = None,
        timeout_s: float | None = None,
    ) -> Scan:
        """Recognise the recording of a scan again, and return the new scan when it has a model. Nothing moves.

        Args:
            scan: The scan, its model, or its id. It may have ended in any state.
            request: Body of `POST /api/scans/SCAN/reprocess`, for example `{"string_radius_m": None}` to measure the
                radius. Members that are absent are as in the scan.
            on_progress: Called with each change of the new scan.
            timeout_s: Time limit, seconds. None: no limit.

        Raises:
            ProblemError: The request was refused, for example because the scan has no recording.
            ScanFailedError: The new scan ended without a model. The error has the reason.
            UnreachableError: The service cannot be reached, or the answer was lost. The error says which.
            NotEndedError: The new scan has not ended within the time limit. It continues.
        """
        return self._run(flows.reprocess(self._service, scan, request or {}, timeout_s), on_progress)

    def start(self, request: Mapping[str, Any], key: str | None = None) -> Scan:
        """Start a scan and return it without waiting for its end.

        Args:
            request: Body of `POST /api/scans`.
            key: Idempotency key. The same key never starts a second scan, unless another token is used. If the first
                request with it is still being processed, the answer is waited for. None: a new key.

        Returns:
            The scan, in its present state.

        Raises:
            ValueError: The request has `validate_only`, and would start no scan.
            ProblemError: The scan was not accepted. The error has the reason.
            UnansweredError: The scan may have been started. The error has the request and the key.
            UnreachableError: The service cannot be reached. This request has started nothing.
        """
        return self._run(flows.start(self._service, request, key))

    def validate(self, request: Mapping[str, Any]) -> ScanValidation:
        """Check a request for a scan without starting one, and return what the scan would use. Nothing moves.

        Args:
            request: Body of `POST /api/scans`.

        Raises:
            ProblemError: The scan would not be accepted. The error has the reason.
            UnreachableError: The service did not answer.
        """
        return self._run(flows.validate(self._service, request))

    def wait(
        self,
        scan: Scan | str,
        on_progress: Callable[[ScanProgress], object] | None = None,
        timeout_s: float | None = None,
    ) -> Scan:
        """Wait until a scan has a model, and return it.

        Args:
            scan: The scan, or its id.
            on_progress: Called with each change of the scan.
            timeout_s: Time limit, seconds. None: no limit.

        Raises:
            ProblemError: There is no such scan.
            ScanFailedError: The scan ended without a model. The error has the reason.
            UnreachableError: The service cannot be reached.
            NotEndedError: The scan has not ended within the time limit. It continues.
        """
        return self._run(flows.wait(self._service, scan, timeout_s), on_progress)

    def get(self, scan_id: str) -> Scan:
        """Return a scan in its present state.

        Args:
            scan_id: Id of the scan.

        Raises:
            ValueError: The text is not the id of a scan.
            ProblemError: There is no such scan.
            UnreachableError: The service cannot be reached.
        """
        return self._run(flows.get_scan(self._service, scan_id))

    def scans(self, **filters: Any) -> Iterator[Scan]:
        """Yield the scans, the newest first. Further pages are read when they are needed.

        Args:
            **filters: Filters of `GET /api/scans`, for example `state`, `mode` or `kept`.

        Raises:
            ProblemError: A filter is not valid.
            UnreachableError: The service cannot be reached.
        """
        page = self._run(flows.scan_page(self._service, flows.SCANS, filters))
        yield from page.scans
        while page.next is not None:
            page = self._run(flows.scan_page(self._service, page.next, {}))
            yield from page.scans

    def model(self, scan: Scan | str, since: ScanRef | None = None) -> Model:
        """Return the model of a scan as arrays.

        Args:
            scan: The scan, or its id.
            since: An earlier scan of the same table, its model, or its id. `model.since` then has the changes since
                that scan. None: `model.since` is None.

        Raises:
            ScanFailedError: The scan has no model.
            ModelError: The document is not a model of schema `pointchain/2`.
            ProblemError: The service refused the request.
            UnreachableError: The service cannot be reached.
        """
        return self._run(flows.model(self._service, scan, since))

    def grasps(
        self,
        scan: ScanRef,
        chain: int | None = None,
        s_range_m: tuple[float | None, float | None] | None = None,
        min_clearance_m: float | None = None,
        reachable: bool | None = None,
        reach: bool | None = None,
        count: int | None = None,
    ) -> GraspList:
        """Return the grasps of a scan with their reach: first the best of each cluster, then all others.

        The filters keep the order and the ids. All given filters must match.

        Args:
            scan: The scan, its model, or its id.
            chain: Only grasps on the chain with this id. None: on all chains.
            s_range_m: Only grasps between these two arc lengths of the chain, metres. It needs `chain`. Each of the two
                may be None for no limit: `(0.1, None)` selects all grasps from 0.1 m on. None: anywhere.
            min_clearance_m: Only grasps with at least this clearance, metres. None: all.
            reachable: True: only grasps that the arm can carry out. False: only the others. None: both.
            reach: Whether the service determines the reach. True: also for a scan with another calibration, for the
                configured cell. None: if the scan has the calibration that is active and the gripper that is
                configured, or if `reachable` is given.
            count: Largest number of grasps. None: all.

        Raises:
            ValueError: `s_range_m` is not two arc lengths, or a model does not say from which scan it is.
            ScanFailedError: The scan has no model.
            ProblemError: A filter does not fit, for example because the model has no such chain
                (`invalid-parameters`), or the reach needs a calibration (`calibration`).
            UnreachableError: The service cannot be reached.
        """
        filters = flows.grasp_filters(chain, s_range_m, min_clearance_m, reachable, reach, count)
        return self._run(flows.grasps(self._service, scan, filters))

    def height_map(self, scan: ScanRef) -> HeightMap:
        """Return the height of the table and of all that lies on it.

        Args:
            scan: The scan, its model, or its id.

        Raises:
            ValueError: A model does not say from which scan it is.
            ScanFailedError: The scan has no model.
            ProblemError: `no-result`: The scan has no height map, because no string was in view.
            UnreachableError: The service cannot be reached.
        """
        return self._run(flows.height_map(self._service, scan))

    def changes(self, scan: ScanRef, since: ScanRef) -> Changes:
        """Return which chain of an earlier scan is which chain of this one, and what is new or gone.

        The service compares the models.

        Args:
            scan: The scan, its model, or its id.
            since: The earlier scan of the same table, its model, or its id.

        Raises:
            ValueError: A model does not say from which scan it is.
            ScanFailedError: The scan has no model.
            ProblemError: The earlier scan has no model, or there is no such scan.
            UnreachableError: The service cannot be reached.
        """
        return self._run(flows.changes(self._service, scan, since))

    def keep(self, scan: ScanRef, kept: bool = True) -> Scan:
        """Protect a scan and its recording from removal, or end the protection. Return the scan.

        Args:
            scan: The scan, its model, or its id.
            kept: Whether the scan is kept.

        Raises:
            ProblemError: There is no such scan.
            UnreachableError: The service did not answer.
        """
        return self._run(flows.keep(self._service, scan, kept))

    def delete(self, scan: ScanRef) -> None:
        """Remove a scan that has ended, with its results, and its recording if no other scan uses it.

        Args:
            scan: The scan, its model, or its id.

        Raises:
            ProblemError: The scan has not ended (`scan-active`), is protected (`scan-kept`), or does not exist.
            UnreachableError: The service did not answer. The scan may have been removed.
        """
        self._run(flows.delete(self._service, scan))

    def upload(self, recording: str | os.PathLike[str]) -> Recording:
        """Upload a recording under the name of its file.

        Args:
            recording: The MCAP file.

        Raises:
            ProblemError: The recording was refused. The error has the reason.
            UnreachableError: The service cannot be reached, or did not take the file.
            OSError: The file cannot be read.
        """
        with Path(recording).open("rb") as file:
            return self._run(flows.upload(self._service, file, recording))

    # The cell

    def cell(self) -> Cell:
        """Return the last known state of the cell: `state`, `problem`, `reason`, robot, camera and calibration.

        Raises:
            UnreachableError: The service cannot be reached.
        """
        return self._run(flows.get_cell(self._service))

    def stop(self) -> None:
        """Stop the arm at once. A running scan is aborted. This is not an emergency stop.

        Without a confirmation, the stop is sent again at once: a second stop does no harm.

        Raises:
            UnreachableError: The service cannot be reached: use the robot's own stop. Or the stop was sent and not
                confirmed: check whether the arm moves.
            ProblemError: The service refused the stop, for example for a wrong token. Nothing was stopped: use the
                robot's own stop.
        """
        self._run(flows.stop(self._service))

    def cancel(self, scan: ScanRef) -> Scan:
        """Stop one scan, the arm first, and return the scan when it has ended.

        Args:
            scan: The scan, its model, or its id. A scan that was aborted before is returned.

        Raises:
            ProblemError: `not-cancellable`: The scan has ended already in another way.
            UnreachableError: The service did not answer.
        """
        return self._run(flows.cancel(self._service, scan))

    def connect(self) -> Cell:
        """Connect arm and camera, and return the cell. Nothing moves.

        Raises:
            ProblemError: A device cannot be connected. The error has the reason.
            UnreachableError: The service did not answer.
        """
        return self._run(flows.connect(self._service))

    def release(self) -> Cell:
        """Wait until the arm is home and release it, so that another program can move it. Return the cell.

        After a stop, the arm is released where it stands, and `robot.at_home` of the cell is false.

        Raises:
            ProblemError: `stopped`: The arm was stopped during the call. It is not home, and must not be moved.
            UnreachableError: The service did not answer.
        """
        return self._run(flows.release(self._service))

    def acknowledge(self) -> None:
        """Acknowledge a fault. Call this only after a person has inspected the cell and says so.

        Raises:
            ProblemError: The fault cannot be acknowledged yet, or there is none.
            UnreachableError: The service did not answer.
        """
        self._run(flows.acknowledge(self._service))

    def _run(self, flow: Flow[T], on_progress: Callable[[ScanProgress], object] | None = None) -> T:
        """Carry out the steps of a flow and return its result."""
        with _Connection(self._http, self._stopping) as connection:
            running = RunningFlow(flow)
            while (step := running.step) is not None:
                # outside `try`: an error of the callback belongs to the caller
                if isinstance(step, ScanProgress):
                    if on_progress is not None:
                        on_progress(step)
                    running.resume(None)
                    continue
                try:
                    result = connection.carry_out(step)
                except httpx2.RequestError as error:
                    running.fail(error)
                else:
                    running.resume(result)
            return running.result


class _Connection:
    """Carries out the steps of one flow, which has at most one open stream of events."""

    def __init__(self, http: httpx2.Client, stopping: httpx2.Client) -> None:
        self._http, self._stopping = http, stopping
        self._stream = ExitStack()
        self._events: Iterator[httpx2.ServerSentEvent] = iter(())

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._stream.close()

    def carry_out(self, step: Request | OpenEvents | NextEvent | CloseEvents | Pause) -> Any:
        """Carry out a step and return its result."""
        match step:
            case Request():
                http = self._stopping if step.is_stop else self._http
                return http.request(**flows.request_arguments(step), content=step.upload)
            case OpenEvents():
                source = self._stream.enter_context(
                    self._http.sse(step.path, headers=step.headers, timeout=step.timeout)
                )
                if not source.response.is_success:
                    source.response.read()
                self._events = iter(source)
                return source.response
            case NextEvent():
                return next(self._events, None)
            case CloseEvents():
                return self._stream.close()
            case Pause():
                return time.sleep(step.seconds)
