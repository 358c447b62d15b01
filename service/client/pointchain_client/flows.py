"""The calls of the client as flows: which requests are sent, what their answers mean, and what is tried again.

No flow requests a motion twice by itself.
"""

import os
import re
import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, BinaryIO, Literal, TypeAlias, TypeVar
from uuid import uuid4

import httpx2

from pointchain_client import retry
from pointchain_client.answers import NOT_SENT_ERRORS, document_of, json_of, require_success
from pointchain_client.documents.cell import Cell, ScanValidation
from pointchain_client.documents.grasps import GraspList, HeightMap
from pointchain_client.documents.model import Changes, Model
from pointchain_client.documents.scans import ID_PATTERN, RESULT_STATES, Recording, Scan, ScanList
from pointchain_client.errors import (
    AnswerError,
    GatewayError,
    ModelError,
    ProblemError,
    ScanFailedError,
    UnansweredError,
    UnreachableError,
)
from pointchain_client.progress import ScanProgress, progress_after, progress_of
from pointchain_client.retry import RETRYABLE_ERRORS, RetryPolicy
from pointchain_client.steps import CloseEvents, Flow, NextEvent, OpenEvents, Pause, Request

Method: TypeAlias = Literal["matching", "enhanced", "graph"]
Views: TypeAlias = int | Literal["auto"]
"""Name of a method. `matching` and `enhanced` are the methods of the paper."""
ScanRef: TypeAlias = Scan | Model | str
"""A scan, its model, or its id."""
D = TypeVar("D")

ANSWER_TIMEOUT_S = 60.0
"""Timeout of an answer. Some answers take long, because `connect` and `release` wait for the arm."""
FINAL_STATE_TIMEOUT_S = 10.0
"""Time limit for reading why a scan has no model. A restart of the service takes some seconds."""
STOP_TIMEOUT_S = 2.0
"""Timeout of one attempt to stop."""
MAX_STOP_ATTEMPTS = 3
SCANS = "/api/scans"
CELL = "/api/cell"

# Requests


def live_request(
    string_radius_m: float | None, method: Method, views: Views | None, all_grasps: bool
) -> Mapping[str, Any]:
    """Return the body of the request for a live scan."""
    return {
        "mode": "live",
        "string_radius_m": string_radius_m,
        "method": method,
        "views": views,
        "all_grasps": all_grasps,
    }


def replay_request(
    recording: str, string_radius_m: float | None, method: Method, all_grasps: bool
) -> Mapping[str, Any]:
    """Return the body of the request for a replay.

    Raises:
        ValueError: The text is not the id of a recording.
    """
    if not re.fullmatch(ID_PATTERN, recording):
        raise ValueError(f"{recording!r} is not the id of a recording; pass a file as Path({recording!r})")
    return {
        "mode": "replay",
        "recording": recording,
        "string_radius_m": string_radius_m,
        "method": method,
        "all_grasps": all_grasps,
    }


def scan_path(scan_id: str) -> str:
    """Return the path of a scan.

    Raises:
        ValueError: The text is not the id of a scan.
    """
    if not re.fullmatch(ID_PATTERN, scan_id):
        raise ValueError(f"{scan_id!r} is not the id of a scan")
    return f"{SCANS}/{scan_id}"


def id_of(scan: ScanRef) -> str:
    """Return the id of a scan.

    Raises:
        ValueError: The model does not say from which scan it is.
    """
    if isinstance(scan, str):
        return scan
    if isinstance(scan, Scan):
        return scan.id
    if scan.provenance is None or scan.provenance.scan is None:
        raise ValueError("the model does not say from which scan it is; pass the scan or its id")
    return scan.provenance.scan


# Scans


def start(service: str, body: Mapping[str, Any], key: str | None, path: str = SCANS) -> Flow[Scan]:
    """Start a scan. If its key is still being processed, wait for the answer."""
    if body.get("validate_only"):
        raise ValueError("a request with validate_only starts no scan; use validate")
    key = key or uuid4().hex
    request = Request("POST", path, json=dict(body), headers={"Idempotency-Key": key})
    end = time.monotonic() + ANSWER_TIMEOUT_S
    pending = False
    while True:
        try:
            return document_of(Scan, (yield request))
        except (httpx2.RequestError, GatewayError, AnswerError) as error:
            if pending or not isinstance(error, NOT_SENT_ERRORS):
                raise UnansweredError(body, key, error) from error
            text = f"{service} cannot be reached ({error}): nothing was started; try again later"
            raise UnreachableError(text) from error
        except ProblemError as error:
            pending = error.slug == "idempotency-pending"
            if not pending:
                raise
            if time.monotonic() > end:
                raise UnansweredError(body, key, error) from error
            yield Pause(error.retry_after_s or retry.RETRY_INTERVAL_S)


def validate(service: str, body: Mapping[str, Any]) -> Flow[ScanValidation]:
    """Check a request for a scan. No scan is started."""
    return document_of(ScanValidation, (yield from _post(service, SCANS, {**body, "validate_only": True})))


def start_and_wait(service: str, body: Mapping[str, Any], timeout_s: float | None) -> Flow[Scan]:
    """Start a scan and wait until it has a model."""
    scan = yield from start(service, body, None)
    return (yield from wait(service, scan, timeout_s))


def reprocess(service: str, scan: ScanRef, body: Mapping[str, Any], timeout_s: float | None) -> Flow[Scan]:
    """Recognise the recording of a scan again, and wait until there is a model."""
    source = id_of(scan)
    try:
        started = yield from start(service, body, None, f"{scan_path(source)}/reprocess")
    except UnansweredError as error:
        text = f"the answer was lost ({error.__cause__}): if a scan was started, scans(source={source!r}) lists it"
        raise UnreachableError(text) from error
    return (yield from wait(service, started, timeout_s))


def wait(service: str, scan: Scan | str, timeout_s: float | None) -> Flow[Scan]:
    """Wait until a scan has a model. Report its progress."""
    path = scan_path(scan) if isinstance(scan, str) else scan.links.self
    policy = RetryPolicy(service, path, None if timeout_s is None else time.monotonic() + timeout_s)
    if isinstance(scan, str):
        scan = document_of(Scan, (yield from get_patiently(path, policy)))
    state = (yield from follow(path, policy)).state
    # a stopping service reports the final state and then disappears, perhaps for good
    failed = state not in RESULT_STATES
    policy.max_outage_s = FINAL_STATE_TIMEOUT_S if failed else policy.max_outage_s
    try:
        ended = document_of(Scan, (yield from get_patiently(path, policy)))
    except UnreachableError as error:
        if failed:
            raise ScanFailedError(replace(scan, state=state, final=True)) from error
        raise
    if ended.state not in RESULT_STATES:
        raise ScanFailedError(ended)
    return ended


def follow(path: str, policy: RetryPolicy) -> Flow[ScanProgress]:
    """Report each change of a scan until it has ended, across any number of lost connections. Return the last one.

    If the service allows no more event streams, the scan is polled.
    """
    last: str | None = None
    progress: ScanProgress | None = None
    while True:
        error: Exception | None = None
        try:
            headers = {} if last is None else {"Last-Event-ID": last}
            require_success((yield OpenEvents(f"{path}/events", headers, policy.timeout)))
            while (event := (yield NextEvent())) is not None:
                policy.record_contact()
                last = event.id or last
                present = progress_after(progress, event)
                if present is not None and present != progress:
                    yield present
                    policy.record_contact()  # the callback may have taken long
                    progress = present
                    if present.ended:
                        yield CloseEvents()
                        return present
                policy.raise_if_expired()
        except RETRYABLE_ERRORS as lost:
            error = lost
        yield CloseEvents()
        if isinstance(error, ProblemError) and error.slug == "too-many-streams":
            error = None
            present = progress_of(json_of((yield from get_patiently(path, policy))))
            if present != progress:
                yield present
                policy.record_contact()
                progress = present
            if present.ended:
                return present
        policy.raise_unless_retryable(error)
        yield Pause(retry.RETRY_INTERVAL_S)


def get_patiently(path: str, policy: RetryPolicy) -> Flow[httpx2.Response]:
    """Read a resource as soon as the service answers."""
    while True:
        try:
            answer = require_success((yield Request("GET", path, timeout=policy.timeout)))
        except RETRYABLE_ERRORS as error:
            policy.raise_unless_retryable(error)
            yield Pause(retry.RETRY_INTERVAL_S)
        else:
            policy.record_contact()
            return answer


def get_scan(service: str, scan_id: str) -> Flow[Scan]:
    """Read a scan."""
    return (yield from _get_document(service, Scan, scan_path(scan_id)))


def scan_page(service: str, path: str, filters: Mapping[str, Any]) -> Flow[ScanList]:
    """Read a page of the list of scans."""
    return (yield from _get_document(service, ScanList, path, filters))


def model(service: str, scan: Scan | str, since: ScanRef | None = None) -> Flow[Model]:
    """Read the model of a scan, if asked with its changes since another scan."""
    if isinstance(scan, str):
        scan = yield from get_scan(service, scan)
    if scan.links.model is None:
        raise ScanFailedError(scan)
    answer = yield from _get(service, scan.links.model, {} if since is None else {"since": id_of(since)})
    return Model.from_json(json_of(answer))


def changes(service: str, scan: ScanRef, since: ScanRef) -> Flow[Changes]:
    """Read the changes from one scan to another."""
    found = yield from model(service, scan if isinstance(scan, Scan) else id_of(scan), since)
    if found.since is None:
        raise ModelError("the service did not answer with the changes: use a service of the client's version")
    return found.since


def grasp_filters(
    chain: int | None,
    s_range_m: tuple[float | None, float | None] | None,
    min_clearance_m: float | None,
    reachable: bool | None,
    reach: bool | None,
    count: int | None,
) -> Mapping[str, Any]:
    """Return the query of a request for grasps."""
    min_s_m, max_s_m = (None, None) if s_range_m is None else _arc_length_range(s_range_m)
    values = {
        "chain": chain,
        "min_s_m": min_s_m,
        "max_s_m": max_s_m,
        "min_clearance_m": min_clearance_m,
        "reachable": reachable,
        "reach": reach,
        "count": count,
    }
    return {name: value for name, value in values.items() if value is not None}


def _arc_length_range(s_range_m: Any) -> tuple[float | None, float | None]:
    """Return the two arc lengths, or raise ValueError."""
    try:
        min_s_m, max_s_m = (None if limit is None else float(limit) for limit in s_range_m)
    except (TypeError, ValueError):
        raise ValueError(
            f"s_range_m is {s_range_m!r}; it must be two arc lengths in metres, for example (0.1, 0.3), "
            "or (0.1, None) for no upper limit"
        ) from None
    return min_s_m, max_s_m


def grasps(service: str, scan: ScanRef, filters: Mapping[str, Any]) -> Flow[GraspList]:
    """Read the grasps of a scan."""
    path = yield from _result_path(service, scan, "grasps")
    return (yield from _get_document(service, GraspList, path, filters))


def height_map(service: str, scan: ScanRef) -> Flow[HeightMap]:
    """Read the height map of a scan."""
    path = yield from _result_path(service, scan, "height-map")
    return (yield from _get_document(service, HeightMap, path))


def _result_path(service: str, scan: ScanRef, name: str) -> Flow[str]:
    """Return the path of a result.

    Raises:
        ScanFailedError: The scan has no model.
    """
    found = scan if isinstance(scan, Scan) else (yield from get_scan(service, id_of(scan)))
    if found.links.model is None:
        raise ScanFailedError(found)
    return f"{scan_path(found.id)}/{name}"


def cancel(service: str, scan: ScanRef) -> Flow[Scan]:
    """Cancel a scan."""
    return document_of(Scan, (yield from _post(service, f"{scan_path(id_of(scan))}/cancel")))


def keep(service: str, scan: ScanRef, kept: bool) -> Flow[Scan]:
    """Mark a scan to be kept, or remove the mark."""
    path = f"{scan_path(id_of(scan))}/keep"
    return document_of(Scan, (yield from _send(service, Request("PUT", path, json={"kept": kept}))))


def delete(service: str, scan: ScanRef) -> Flow[None]:
    """Remove a scan."""
    yield from _send(service, Request("DELETE", scan_path(id_of(scan))))


def upload(service: str, file: BinaryIO, recording: str | os.PathLike[str]) -> Flow[Recording]:
    """Upload an open recording under the name of its file."""
    name = os.fsencode(Path(recording).name).decode(errors="replace")  # a file name may be undecodable
    headers = {"Content-Length": str(os.fstat(file.fileno()).st_size)}
    try:
        answer = yield Request("POST", "/api/recordings", {"name": name}, headers=headers, upload=file)
    except httpx2.RequestError as error:
        raise UnreachableError(f"{service} did not accept the recording ({error}): upload it again") from error
    return document_of(Recording, answer)


# The cell


def get_cell(service: str) -> Flow[Cell]:
    """Read the cell."""
    return (yield from _get_document(service, Cell, CELL))


def stop(service: str) -> Flow[None]:
    """Stop the arm. Without a confirmation, send the stop again at once: a second stop does no harm."""
    lost: list[Exception] = []
    for _ in range(MAX_STOP_ATTEMPTS):
        try:
            json_of((yield Request("POST", f"{CELL}/stop", is_stop=True)))
            return
        except (httpx2.RequestError, UnreachableError, AnswerError) as error:
            lost.append(error)
    sent = [error for error in lost if not isinstance(error, NOT_SENT_ERRORS)]
    if sent:
        raise UnreachableError(
            f"the stop was sent and not confirmed ({sent[-1]}): check whether the arm moves, and use the robot's "
            "own stop if it does"
        ) from sent[-1]
    text = f"the stop was not sent, because {service} cannot be reached ({lost[-1]}): use the robot's own stop"
    raise UnreachableError(text) from lost[-1]


def connect(service: str) -> Flow[Cell]:
    """Connect arm and camera."""
    return document_of(Cell, (yield from _post(service, f"{CELL}/connect")))


def release(service: str) -> Flow[Cell]:
    """Release the arm when it is home."""
    return document_of(Cell, (yield from _post(service, f"{CELL}/release")))


def acknowledge(service: str) -> Flow[None]:
    """Acknowledge a fault."""
    yield from _post(service, f"{CELL}/acknowledge")


def _post(service: str, path: str, body: Mapping[str, Any] | None = None) -> Flow[httpx2.Response]:
    return (yield from _send(service, Request("POST", path, json=body)))


def _send(service: str, request: Request) -> Flow[httpx2.Response]:
    """Send a command, once."""
    try:
        return require_success((yield request))
    except httpx2.RequestError as error:
        raise UnreachableError(
            f"{service} did not answer {request.method} {request.path} ({error}): check the cell, then try again"
        ) from error


def _get(service: str, path: str, params: Mapping[str, Any] | None = None) -> Flow[httpx2.Response]:
    """Read a resource. A second attempt covers a connection that the service has just closed."""
    for left in (1, 0):
        try:
            return require_success((yield Request("GET", path, params or {})))
        except httpx2.RequestError as error:
            if not left:
                raise UnreachableError(f"{service} does not answer ({error}): try again later") from error
            yield Pause(retry.RETRY_INTERVAL_S)
    raise AssertionError


def _get_document(service: str, kind: type[D], path: str, params: Mapping[str, Any] | None = None) -> Flow[D]:
    return document_of(kind, (yield from _get(service, path, params)))


# Arguments of httpx2


def check_address(address: str) -> str:
    """Return the address of a service.

    Raises:
        ValueError: It does not begin with `http://` or `https://`.
    """
    if not address.startswith(("http://", "https://")):
        raise ValueError(f"{address!r} is not the address of a service: it begins with http:// or https://")
    return address


def token_headers(token: str | None) -> dict[str, str]:
    """Return the headers with a token, if there is one."""
    return {} if token is None else {"Authorization": f"Bearer {token}"}


def request_arguments(request: Request) -> dict[str, Any]:
    """Return the arguments of `httpx2.Client.request` for a request, except for an uploaded file."""
    arguments: dict[str, Any] = {"method": request.method, "url": request.path, "headers": request.headers}
    if request.params:  # an empty mapping would remove the query of the path
        arguments["params"] = request.params
    if request.json is not None:
        arguments["json"] = request.json
    if request.timeout is not None:
        arguments["timeout"] = request.timeout
    return arguments
