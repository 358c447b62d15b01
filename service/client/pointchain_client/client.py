"""Client of the service, for programs that plan with its models.

The client never requests a motion twice by itself. If an answer is lost, `UnansweredError` has the request and the key
with which `start` finds the scan, or starts it if it was not started.
"""

import os
import re
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, Self
from uuid import uuid4

import httpx2

from recognition.model.model import Method, PointChainModel
from service.api.schemas.scans import RecordingResource, ScanResource
from pointchain_client.errors import (
    NOT_SENT_ERRORS,
    GatewayError,
    ProblemError,
    ScanFailedError,
    UnansweredError,
    UnreachableError,
    require_success,
)
from pointchain_client.progress import ScanProgress, follow, get_json
from pointchain_client.retry import CONNECT_TIMEOUT_S, RETRY_INTERVAL_S, RetryPolicy
from service.states import ID_PATTERN, RESULT_STATES

ANSWER_TIMEOUT_S = 60.0
"""Timeout of an answer. Accepting a live scan takes seconds, because arm and camera are connected first."""
FINAL_STATE_TIMEOUT_S = 10.0
"""Time limit for reading why a scan has no model. A restart of the service takes some seconds."""
STOP_TIMEOUT_S = 2.0
"""Timeout of one attempt to stop."""
MAX_STOP_ATTEMPTS = 3


class Client:
    """A connection to one service. Use it as a context manager.

    All methods may be called from several threads. Call `stop` from another thread than the one that waits for a scan.

    Example:
        A scan, its model, and a grasp. `scan` moves the arm.

        >>> from pointchain_client import Client
        >>> def plan(cell: Client) -> None:
        ...     scan = cell.scan(string_radius_m=0.0042, on_progress=print)
        ...     model = cell.model(scan)
        ...     if model.grasps and model.trusted(model.grasps[0].chain):
        ...         cell.release()  # the arm is home, and your program may move it
        ...         print(model.grasps[0].T_base_grasp)  # (4, 4), base frame
        >>> with Client("http://127.0.0.1:8000", token=None) as cell:
        ...     pass  # plan(cell) with a service at this address
    """

    def __init__(self, address: str = "http://127.0.0.1:8000", token: str | None = None) -> None:
        """Create a client. No connection is made yet.

        Args:
            address: Address of the service.
            token: Token from `pointchain token add`. None: the service needs no token.
        """
        headers = {} if token is None else {"Authorization": f"Bearer {token}"}
        timeout = httpx2.Timeout(ANSWER_TIMEOUT_S, connect=CONNECT_TIMEOUT_S)
        self._http = httpx2.Client(base_url=address, headers=headers, timeout=timeout)
        # separate, so that a running request never holds the connection that a stop needs
        self._stopping = httpx2.Client(base_url=address, headers=headers, timeout=STOP_TIMEOUT_S)

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
        views: int | None = None,
        all_grasps: bool = False,
        on_progress: Callable[[ScanProgress], None] | None = None,
        timeout_s: float | None = None,
    ) -> ScanResource:
        """Run a live scan and return it when it has a model. The arm moves, and may still be on its way home.

        Leaving early, by Ctrl-C or `timeout_s`, does not stop the arm: call `stop`.

        Args:
            string_radius_m: Radius of the string, metres. None: the radius of the cell's configuration, or measured.
            method: Recognition method.
            views: Number of viewpoints. None: as configured.
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
        request = {
            "mode": "live",
            "string_radius_m": string_radius_m,
            "method": method,
            "views": views,
            "all_grasps": all_grasps,
        }
        return self.wait(self.start(request), on_progress, timeout_s)

    def replay(
        self,
        recording: str | os.PathLike[str],
        string_radius_m: float | None = None,
        method: Method = "graph",
        all_grasps: bool = False,
        on_progress: Callable[[ScanProgress], None] | None = None,
        timeout_s: float | None = None,
    ) -> ScanResource:
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
        if not re.fullmatch(ID_PATTERN, recording_id):
            raise ValueError(f"{recording_id!r} is not the id of a recording; pass a file as Path({recording_id!r})")
        request = {
            "mode": "replay",
            "recording": recording_id,
            "string_radius_m": string_radius_m,
            "method": method,
            "all_grasps": all_grasps,
        }
        return self.wait(self.start(request), on_progress, timeout_s)

    def start(self, request: Mapping[str, Any], key: str | None = None) -> ScanResource:
        """Start a scan and return it without waiting for its end.

        Args:
            request: Body of `POST /api/scans`.
            key: Idempotency key. The same key never starts a second scan, unless another token is used. If the first
                request with it is still being processed, the answer is waited for. None: a new key.

        Returns:
            The scan, in its present state.

        Raises:
            ProblemError: The scan was not accepted. The error has the reason.
            UnansweredError: The scan may have been started. The error has the request and the key.
            UnreachableError: The service cannot be reached. This request has started nothing.
        """
        key = key or uuid4().hex
        end = time.monotonic() + ANSWER_TIMEOUT_S
        pending = False
        while True:
            try:
                answer = self._http.post("/api/scans", json=dict(request), headers={"Idempotency-Key": key})
                return ScanResource.model_validate(require_success(answer).json())
            except (httpx2.TransportError, GatewayError) as error:
                if pending or not isinstance(error, NOT_SENT_ERRORS):
                    raise UnansweredError(request, key, error) from error
                text = f"{self._http.base_url} cannot be reached ({error}): nothing was started; try again later"
                raise UnreachableError(text) from error
            except ProblemError as error:
                pending = error.slug == "idempotency-pending"
                if not pending:
                    raise
                if time.monotonic() > end:
                    raise UnansweredError(request, key, error) from error
                time.sleep(error.retry_after_s or RETRY_INTERVAL_S)

    def wait(
        self,
        scan: ScanResource | str,
        on_progress: Callable[[ScanProgress], None] | None = None,
        timeout_s: float | None = None,
    ) -> ScanResource:
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
        address = _address(scan) if isinstance(scan, str) else scan.links.self
        retry = RetryPolicy(self._http, address, None if timeout_s is None else time.monotonic() + timeout_s)
        if isinstance(scan, str):
            scan = ScanResource.model_validate(get_json(self._http, address, retry))
        state = scan.state
        for progress in follow(self._http, address, retry):
            state = progress.state
            if on_progress is not None:
                on_progress(progress)
                retry.record_contact()  # the callback may have taken long
        # a stopping service reports the final state and then disappears, perhaps for good
        failed = state not in RESULT_STATES
        retry.max_outage_s = FINAL_STATE_TIMEOUT_S if failed else retry.max_outage_s
        try:
            ended = ScanResource.model_validate(get_json(self._http, address, retry))
        except UnreachableError as error:
            if failed:
                raise ScanFailedError(scan.model_copy(update={"state": state})) from error
            raise
        if ended.state not in RESULT_STATES:
            raise ScanFailedError(ended)
        return ended

    def get(self, scan_id: str) -> ScanResource:
        """Return a scan in its present state.

        Args:
            scan_id: Id of the scan.

        Raises:
            ValueError: The text is not the id of a scan.
            ProblemError: There is no such scan.
            UnreachableError: The service cannot be reached.
        """
        return ScanResource.model_validate(self._get(_address(scan_id)).json())

    def scans(self, **filters: Any) -> Iterator[ScanResource]:
        """Yield the scans, the newest first. Further pages are read when they are needed.

        Args:
            **filters: Filters of `GET /api/scans`, for example `state`, `mode` or `kept`.

        Raises:
            ProblemError: A filter is not valid.
            UnreachableError: The service cannot be reached.
        """
        page = self._get("/api/scans", filters).json()
        while True:
            yield from map(ScanResource.model_validate, page["scans"])
            if page["next"] is None:
                return
            page = self._get(page["next"]).json()

    def model(self, scan: ScanResource | str) -> PointChainModel:
        """Return the model of a scan as arrays.

        A scan of an earlier release may have a model of schema `pointchain/1`. Each of its messages becomes a doubt.

        Args:
            scan: The scan, or its id.

        Raises:
            ScanFailedError: The scan has no model.
            ModelError: The document is not a model of a known schema.
            ProblemError: The service refused the request.
            UnreachableError: The service cannot be reached.
        """
        scan = self.get(scan) if isinstance(scan, str) else scan
        if scan.links.model is None:
            raise ScanFailedError(scan)
        return PointChainModel.from_json(self._get(scan.links.model).json())

    def upload(self, recording: str | os.PathLike[str]) -> RecordingResource:
        """Upload a recording under the name of its file.

        Args:
            recording: The MCAP file.

        Raises:
            ProblemError: The recording was refused. The error has the reason.
            UnreachableError: The service cannot be reached, or did not take the file.
            OSError: The file cannot be read.
        """
        recording = Path(recording)
        name = os.fsencode(recording.name).decode(errors="replace")  # a file name may be undecodable
        with recording.open("rb") as file:
            try:
                answer = self._http.post("/api/recordings", params={"name": name}, content=file)
            except httpx2.TransportError as error:
                raise UnreachableError(
                    f"{self._http.base_url} did not accept the recording ({error}): upload it again"
                ) from error
        return RecordingResource.model_validate(require_success(answer).json())

    # The cell

    def cell(self) -> Mapping[str, Any]:
        """Return the cell as in `GET /api/cell`: `state`, `problem`, `reason`, robot, camera and calibration."""
        return self._get("/api/cell").json()

    def stop(self) -> None:
        """Stop the arm at once. A running scan is aborted. This is not an emergency stop.

        Without an answer, the stop is sent again at once: a second stop does no harm.

        Raises:
            UnreachableError: The service cannot be reached: use the robot's own stop. Or the stop was sent and not
                confirmed: check whether the arm moves.
            ProblemError: The service refused the stop, for example for a wrong token. Nothing was stopped: use the
                robot's own stop.
        """
        lost: list[Exception] = []
        for _ in range(MAX_STOP_ATTEMPTS):
            try:
                require_success(self._stopping.post("/api/cell/stop"))
                return
            except (httpx2.TransportError, GatewayError) as error:
                lost.append(error)
        sent = [error for error in lost if not isinstance(error, NOT_SENT_ERRORS)]
        if sent:
            raise UnreachableError(
                f"the stop was sent and not confirmed ({sent[-1]}): check whether the arm moves, and use the robot's "
                "own stop if it does"
            ) from sent[-1]
        text = (
            f"the stop was not sent, because {self._stopping.base_url} cannot be reached ({lost[-1]}): use the robot's "
            "own stop"
        )
        raise UnreachableError(text) from lost[-1]

    def cancel(self, scan: ScanResource) -> ScanResource:
        """Stop one scan, the arm first, and return the scan when it has ended.

        Args:
            scan: The scan.

        Raises:
            ProblemError: `not-cancellable`: The scan has ended already.
            UnreachableError: The service did not answer.
        """
        return ScanResource.model_validate(self._post(f"{scan.links.self}/cancel").json())

    def connect(self) -> Mapping[str, Any]:
        """Connect arm and camera, and return the cell. Nothing moves.

        Raises:
            ProblemError: A device cannot be connected. The error has the reason.
            UnreachableError: The service did not answer.
        """
        return self._post("/api/cell/connect").json()

    def release(self) -> None:
        """Wait until the arm is home and release it, so that another program can move it.

        After a stop, the arm is released where it stands.

        Raises:
            ProblemError: `stopped`: The arm was stopped during the call. It is not home, and must not be moved.
            UnreachableError: The service did not answer.
        """
        self._post("/api/cell/release")

    def acknowledge(self) -> None:
        """Acknowledge a fault. Call this only after a person has inspected the cell and says so.

        Raises:
            ProblemError: The fault cannot be acknowledged yet, or there is none.
            UnreachableError: The service did not answer.
        """
        self._post("/api/cell/acknowledge")

    def _post(self, address: str) -> httpx2.Response:
        try:
            return require_success(self._http.post(address))
        except httpx2.TransportError as error:
            raise UnreachableError(
                f"{self._http.base_url} did not answer POST {address} ({error}): check the cell, then try again"
            ) from error

    def _get(self, address: str, parameters: Mapping[str, Any] | None = None) -> httpx2.Response:
        """Read a resource. A second attempt covers a connection that the service has just closed."""
        for left in (1, 0):
            try:
                return require_success(self._http.get(address, params=parameters))
            except httpx2.TransportError as error:
                if not left:
                    raise UnreachableError(
                        f"{self._http.base_url} does not answer ({error}): try again later"
                    ) from error
                time.sleep(RETRY_INTERVAL_S)
        raise AssertionError


def _address(scan_id: str) -> str:
    if not re.fullmatch(ID_PATTERN, scan_id):
        raise ValueError(f"{scan_id!r} is not the id of a scan")
    return f"/api/scans/{scan_id}"
