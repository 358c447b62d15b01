"""Recordings: upload, list, look at, download."""

import hashlib
import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path, PurePosixPath
from typing import Annotated, Any

from anyio import WouldBlock, to_thread
from fastapi import APIRouter, Query, Request, Response
from fastapi.responses import FileResponse
from starlette.requests import ClientDisconnect

from cell.recording.errors import RecordingError
from service.api.dependencies import Before, Context, Limit, Recording, Service
from service.api.file_responses import NOT_MODIFIED, IfNoneMatch, present, send_file
from service.api.openapi import links
from service.api.pagination import page
from service.api.problem_responses import RECORDING, problem_responses
from service.api.schemas.addresses import RECORDINGS
from service.api.schemas.recording_resource import recording_resource
from service.api.schemas.scans import RecordingList, RecordingResource
from service.problems.problem_error import ProblemError
from service.processing.upload_sandbox import describe_foreign_recording
from service.storage.database import new_id
from service.storage.rows import RecordingRow

MCAP = "application/octet-stream"
UPLOADS = 4
"""So many recordings are taken at a time."""
LOOK_BYTES = 1 << 20
"""Whenever so much more of one has come, it is looked whether there is space for more."""

Name = Annotated[str | None, Query(max_length=255, description="What the file is called where it comes from")]

router = APIRouter(prefix=RECORDINGS, tags=["recordings"])

BINARY = {"schema": {"type": "string", "format": "binary"}}
BODY = {"required": True, "content": {MCAP: BINARY}}
REPLAY = {"operationId": "start_scan", "requestBody": {"mode": "replay", "recording": "$response.body#/id"}}
FOLLOWING = links("get_recording", "download_recording")
KEPT = problem_responses(
    *RECORDING, "recording-too-large", "busy", "invalid-request", "storage-full", "too-large", "upload-incomplete"
) | {201: {"links": FOLLOWING["links"] | {"start_scan": REPLAY}}}


@router.post("", status_code=201, responses=KEPT, openapi_extra={"requestBody": BODY})
async def upload_recording(
    request: Request, response: Response, service: Service, name: Name = None
) -> RecordingResource:
    """Takes a recording (the MCAP file as the body) and keeps it if it can be used."""
    with _one_of_few(service):
        row = await _take(request, service, _file_name(name))
    response.headers["Location"] = f"{RECORDINGS}/{row.id}"
    return recording_resource(row)


@router.get("", responses=problem_responses("invalid-request"))
def list_recordings(request: Request, service: Service, limit: Limit = 100, before: Before = None) -> RecordingList:
    """The recordings, the newest first."""
    rows, following = page(service.store.recordings(limit + 1, before), limit, request)
    return RecordingList(recordings=[recording_resource(row) for row in rows], next=following)


@router.get("/{id}", responses=problem_responses("recording-not-found", "invalid-request"))
def get_recording(recording: Recording) -> RecordingResource:
    """What is known of a recording."""
    return recording_resource(recording)


FILE: dict[int | str, dict[str, Any]] = {200: {"content": {MCAP: BINARY}}}


REFUSALS = NOT_MODIFIED | problem_responses("recording-not-found", "no-result", "invalid-request")


@router.get("/{id}/file", response_class=FileResponse, responses=FILE | REFUSALS)
def download_recording(recording: Recording, service: Service, has: IfNoneMatch) -> Response:
    """The MCAP file as it was uploaded."""
    return send_recording(service, recording, has)


def send_recording(service: Context, recording: RecordingRow, has: str | None) -> Response:
    """The answer that sends the recording's file; `has` are the ETags of what the client has."""
    return send_file(
        service.store.folder.recording(recording.id),
        MCAP,
        has,
        save_as=f"{recording.id}.mcap",
        sha256=recording.sha256,
        size_bytes=recording.size_bytes,
    )


def require_whole(service: Context, recording: RecordingRow) -> None:
    """Lets pass a recording whose file has the size that it was kept with. Raises ProblemError as `present`."""
    present(service.store.folder.recording(recording.id), size_bytes=recording.size_bytes)


@contextmanager
def _one_of_few(service: Context) -> Iterator[None]:
    """Raises ProblemError: `busy`."""
    try:
        service.uploads.acquire_nowait()
    except WouldBlock:
        detail = f"{UPLOADS} recordings are being uploaded already; try again"
        raise ProblemError("busy", detail, {"Retry-After": "5"}) from None
    try:
        yield
    finally:
        service.uploads.release()


def _file_name(told: str | None) -> str | None:
    """The name without folders and without what cannot be printed: it is only ever shown."""
    last = PurePosixPath((told or "").replace("\\", "/")).name
    return "".join(sign for sign in last if sign.isprintable()) or None


async def _take(request: Request, service: Context, name: str | None) -> RecordingRow:
    recording_id = new_id()
    path = service.store.folder.incoming(f"upload-{recording_id}.mcap")
    declared = request.headers.get("content-length", "")
    length = int(declared) if declared.isdecimal() else 0
    # One that is larger than any may be is refused for that, as soon as it is read.
    coming = 0 if length > service.config.limits.upload_bytes else length
    await to_thread.run_sync(service.require_space, coming)
    try:
        sha256 = await _receive(request, path, service)
        row = await to_thread.run_sync(describe_foreign_recording, recording_id, path, sha256, limiter=service.parsing)
        row = replace(row, name=name)
        await to_thread.run_sync(service.store.add_recording, row, path)
    except RecordingError as error:
        # It tells the file's name here, which the sender does not know.
        raise type(error)(str(error).replace(path.name, name or "the recording")) from error
    finally:
        await to_thread.run_sync(lambda: path.unlink(missing_ok=True))
    return row


async def _receive(request: Request, path: Path, service: Context) -> str:
    """Writes the body to `path`, synced, as long as there is space for it; its SHA-256."""
    digest, unlooked = hashlib.sha256(), 0
    file = await to_thread.run_sync(path.open, "xb")

    def write(chunk: bytes) -> None:
        nonlocal unlooked
        unlooked += len(chunk)
        if unlooked >= LOOK_BYTES:  # nobody knows beforehand how much comes, nor what else takes space meanwhile
            service.require_space(len(chunk))
            unlooked = 0
        file.write(chunk)
        digest.update(chunk)

    def finish() -> None:
        file.flush()
        os.fsync(file.fileno())

    try:
        async for chunk in request.stream():
            await to_thread.run_sync(write, chunk)
        await to_thread.run_sync(finish)
        return digest.hexdigest()
    except ClientDisconnect as error:
        raise ProblemError("upload-incomplete", "the connection ended before the recording did") from error
    finally:
        await to_thread.run_sync(file.close)
