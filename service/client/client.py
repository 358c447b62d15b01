"""A client of the service, for programs that plan with its models.

    with Client("http://cell:8000", token="pct_...") as cell:
        scan = cell.scan(string_radius_m=0.0042, on_progress=print)
        model = cell.model(scan)
        cell.release()                                   # the arm is yours
        grasp = model.grasps[0].T_base_grasp             # (4, 4), base frame

Nothing here asks a second time for a motion: where an answer is lost, `UnansweredError` has the wish and the key with
which `start` finds out whether the scan was begun.
"""

import os
import re
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, Self
from uuid import uuid4

import httpx

from recognition.model import Method, PointChainModel
from service.client.errors import (
    NOT_SENT,
    AwayError,
    ProblemError,
    ScanFailedError,
    UnansweredError,
    UnreachableError,
    require_success,
)
from service.client.model_arrays import model_from_json
from service.client.patience import AGAIN_S, CONNECT_S, Patience
from service.client.progress import ScanProgress, follow, look
from service.schemas import ID_PATTERN, RESULT_STATES, RecordingResource, ScanResource

ANSWER_S = 60.0
"""A live scan is accepted once arm and camera are connected, which takes seconds."""
END_S = 10.0
"""For so long the reason is asked for of a scan that has no model; a service that starts anew needs some seconds."""
STOP_S = 2.0
STOP_TRIES = 3


class Client:
    """One service. Safe to use from several threads: `stop` is meant to be called from another one."""

    def __init__(self, address: str = "http://127.0.0.1:8000", token: str | None = None) -> None:
        """`token` as `pointchain token add` gave it; None where the service asks for none."""
        headers = {} if token is None else {"Authorization": f"Bearer {token}"}
        wait = httpx.Timeout(ANSWER_S, connect=CONNECT_S)
        self._http = httpx.Client(base_url=address, headers=headers, timeout=wait)
        # Of its own, so that no other request under way takes the connection that a stop needs.
        self._stopping = httpx.Client(base_url=address, headers=headers, timeout=STOP_S)

    def close(self) -> None:
        """Closes the connections. A scan under way goes on."""
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
        on_progress: Callable[[ScanProgress], None] | None = None,
        timeout_s: float | None = None,
    ) -> ScanResource:
        """A live scan: the arm moves. Returns when there is a model; the arm may still be on its way home.

        `string_radius_m` None: the cell's, else measured. Leaving early, by Ctrl-C or `timeout_s`, does not stop the
        arm: that is for `stop`.

        Raises:
            ProblemError: it was not accepted; nothing moved.
            ScanFailedError: it came to no model, for the reason that it has.
            UnansweredError, UnreachableError: the service cannot be reached.
            NotEndedError: a TimeoutError, it has not ended in time.
        """
        wish = {"mode": "live", "string_radius_m": string_radius_m, "method": method, "views": views}
        return self.wait(self.start(wish), on_progress, timeout_s)

    def replay(
        self,
        recording: str | Path,
        string_radius_m: float | None = None,
        method: Method = "graph",
        on_progress: Callable[[ScanProgress], None] | None = None,
        timeout_s: float | None = None,
    ) -> ScanResource:
        """The same from a recording: the id of one that the service has, or the Path of a file, which is uploaded anew
        at each call. ValueError: a text that is no id."""
        known = self.upload(recording).id if isinstance(recording, Path) else recording
        if not re.fullmatch(ID_PATTERN, known):
            raise ValueError(f"{known!r} is not the id of a recording; a file is given as Path({known!r})")
        wish = {"mode": "replay", "recording": known, "string_radius_m": string_radius_m, "method": method}
        return self.wait(self.start(wish), on_progress, timeout_s)

    def start(self, wish: Mapping[str, Any], key: str | None = None) -> ScanResource:
        """Starts a scan and does not wait: `wish` is the body of POST /api/scans. The same `key` never starts a second,
        unless another token is used.

        While the first request with it is being decided on, the answer is waited for.

        Raises:
            ProblemError: it was not accepted, with the reason.
            UnansweredError: whether it was is not known; it has the wish and the key.
            UnreachableError: the service cannot be reached; this request has begun nothing.
        """
        key = key or uuid4().hex
        end = time.monotonic() + ANSWER_S
        pending = False
        while True:
            try:
                answer = self._http.post("/api/scans", json=dict(wish), headers={"Idempotency-Key": key})
                return ScanResource.model_validate(require_success(answer).json())
            except (httpx.TransportError, AwayError) as error:
                if pending or not isinstance(error, NOT_SENT):
                    raise UnansweredError(wish, key, error) from error
                text = f"{self._http.base_url} cannot be reached ({error}): nothing was begun"
                raise UnreachableError(text) from error
            except ProblemError as error:
                pending = error.slug == "idempotency-pending"
                if not pending:
                    raise
                if time.monotonic() > end:
                    raise UnansweredError(wish, key, error) from error
                time.sleep(error.retry_after_s or AGAIN_S)

    def wait(
        self,
        scan: ScanResource | str,
        on_progress: Callable[[ScanProgress], None] | None = None,
        timeout_s: float | None = None,
    ) -> ScanResource:
        """Returns the scan, or that of an id, when it has a model; `on_progress` is called with each change.

        Raises: ScanFailedError, UnreachableError and NotEndedError as `scan`; ProblemError when there is no such scan.
        """
        address = _address(scan) if isinstance(scan, str) else scan.links.self
        patience = Patience(self._http, address, None if timeout_s is None else time.monotonic() + timeout_s)
        if isinstance(scan, str):
            scan = ScanResource.model_validate(look(self._http, address, patience))
        state = scan.state
        for progress in follow(self._http, address, patience):
            state = progress.state
            if on_progress is not None:
                on_progress(progress)
                patience.heard()  # that may have taken long
        # A service that is ending tells how the scan ended, and is away then: perhaps for ever.
        failed = state not in RESULT_STATES
        patience.lost_s = END_S if failed else patience.lost_s
        try:
            ended = ScanResource.model_validate(look(self._http, address, patience))
        except UnreachableError as error:
            if failed:
                raise ScanFailedError(scan.model_copy(update={"state": state})) from error
            raise
        if ended.state not in RESULT_STATES:
            raise ScanFailedError(ended)
        return ended

    def get(self, scan_id: str) -> ScanResource:
        """A scan as it is now. Raises ProblemError, UnreachableError; ValueError: a text that is no id."""
        return ScanResource.model_validate(self._get(_address(scan_id)).json())

    def scans(self, **filters: Any) -> Iterator[ScanResource]:
        """The scans, the newest first, page by page; `filters` as of GET /api/scans (`state`, `mode`, `kept` ...)."""
        page = self._get("/api/scans", filters).json()
        while True:
            yield from map(ScanResource.model_validate, page["scans"])
            if page["next"] is None:
                return
            page = self._get(page["next"]).json()

    def model(self, scan: ScanResource | str) -> PointChainModel:
        """The model of a scan, or of that of an id, as arrays.

        Raises: ScanFailedError when it has none; ProblemError, UnreachableError; ModelError when it is none.
        """
        scan = self.get(scan) if isinstance(scan, str) else scan
        if scan.links.model is None:
            raise ScanFailedError(scan)
        return model_from_json(self._get(scan.links.model).json())

    def upload(self, recording: Path) -> RecordingResource:
        """Gives the service a recording, with the file's name. Raises ProblemError, UnreachableError, OSError."""
        name = os.fsencode(recording.name).decode(errors="replace")  # a file's name need not be a text
        with recording.open("rb") as file:
            try:
                answer = self._http.post("/api/recordings", params={"name": name}, content=file)
            except httpx.TransportError as error:
                raise UnreachableError(f"{self._http.base_url} did not take the recording: {error}") from error
        return RecordingResource.model_validate(require_success(answer).json())

    # The cell

    def cell(self) -> Mapping[str, Any]:
        """The cell as GET /api/cell has it: `state`, `problem`, `reason`, robot, camera ..."""
        return self._get("/api/cell").json()

    def stop(self) -> None:
        """Stops the arm at once, whatever goes on; a scan under way is aborted. Not an emergency stop.

        Tried again at once when there is no answer: a second stop does no harm.

        Raises:
            UnreachableError: the service cannot be reached, use the robot's own stop; or it was sent and not confirmed,
                look whether the arm moves.
            ProblemError: the service refused it, as for a wrong token, and nothing was stopped: use the robot's own.
        """
        lost: list[Exception] = []
        for _ in range(STOP_TRIES):
            try:
                require_success(self._stopping.post("/api/cell/stop"))
                return
            except (httpx.TransportError, AwayError) as error:
                lost.append(error)
        sent = [error for error in lost if not isinstance(error, NOT_SENT)]
        if sent:
            raise UnreachableError(
                f"the stop was sent and not confirmed ({sent[-1]}): look whether the arm moves, and use the robot's "
                "own stop if it does"
            ) from sent[-1]
        text = f"{self._stopping.base_url} does not take the stop ({lost[-1]}): use the robot's own"
        raise UnreachableError(text) from lost[-1]

    def cancel(self, scan: ScanResource) -> ScanResource:
        """Stops this scan, the arm first. ProblemError: `not-cancellable`, it has ended already and was not stopped."""
        return ScanResource.model_validate(self._do(f"{scan.links.self}/cancel").json())

    def connect(self) -> Mapping[str, Any]:
        """Connects arm and camera; nothing moves. The cell, as `cell` gives it. Raises ProblemError."""
        return self._do("/api/cell/connect").json()

    def release(self) -> None:
        """Waits for the arm to be home, then lets it go, so that another program can move it.

        Raises:
            ProblemError: `stopped` when somebody stopped the arm meanwhile: it is not home, nor wanted to move. When it
                was stopped before, it is let go where it stands.
        """
        self._do("/api/cell/release")

    def acknowledge(self) -> None:
        """A person has looked at the cell after a fault: only ever call this because one says so. Raises
        ProblemError."""
        self._do("/api/cell/acknowledge")

    def _do(self, address: str) -> httpx.Response:
        try:
            return require_success(self._http.post(address))
        except httpx.TransportError as error:
            raise UnreachableError(f"{self._http.base_url} did not answer POST {address}: {error}") from error

    def _get(self, address: str, parameters: Mapping[str, Any] | None = None) -> httpx.Response:
        """Reading may be tried again: once, for a connection that the service has just closed."""
        for left in (1, 0):
            try:
                return require_success(self._http.get(address, params=parameters))
            except httpx.TransportError as error:
                if not left:
                    raise UnreachableError(f"{self._http.base_url} does not answer: {error}") from error
                time.sleep(AGAIN_S)
        raise AssertionError


def _address(scan_id: str) -> str:
    if not re.fullmatch(ID_PATTERN, scan_id):
        raise ValueError(f"{scan_id!r} is not the id of a scan")
    return f"/api/scans/{scan_id}"
