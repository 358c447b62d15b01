"""Routes of recordings: upload, list, read, download."""

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
from service.api.file_responses import NOT_MODIFIED, IfNoneMatch, send_file, stat_file
from service.api.openapi import links
from service.api.pagination import paginate
from service.api.problem_responses import RECORDING, problem_responses
from service.api.schemas.addresses import RECORDINGS
from service.api.schemas.recording_resource import recording_resource
from service.api.schemas.scans import RecordingList, RecordingResource
from service.problems.problem_error import ProblemError
from service.processing.upload_sandbox import describe_untrusted_recording
from service.storage.database import new_id
from service.storage.rows import RecordingRow

MCAP = "application/octet-stream"
MAX_UPLOADS = 4
"""Number of concurrent uploads."""
SPACE_CHECK_BYTES = 1 << 20
"""Number of uploaded bytes after which the free space is checked again."""

Name = Annotated[str | None, Query(max_length=255, description="Name of the file at its sender")]

router = APIRouter(prefix=RECORDINGS, tags=["recordings"])

BINARY = {"schema": {"type": "string", "format": "binary"}}
BODY = {"required": True, "content": {MCAP: BINARY}}
# no `requestBody`: the parser of OpenAPI Generator takes only a string there
REPLAY = {"operationId": "start_scan", "description": "`recording` of the request is the `id` in this answer."}
LINKS = links("get_recording", "download_recording")
UPLOAD_RESPONSES = problem_responses(
    *RECORDING, "recording-too-large", "busy", "invalid-request", "storage-full", "too-large", "upload-incomplete"
) | {201: {"links": LINKS["links"] | {"start_scan": REPLAY}}}


@router.post("", status_code=201, responses=UPLOAD_RESPONSES, openapi_extra={"requestBody": BODY})
async def upload_recording(
    request: Request, response: Response, service: Service, name: Name = None
) -> RecordingResource:
    """Upload a recording, with the MCAP file as the body. It is stored if it can be used."""
    with _upload_slot(service):
        row = await _store_upload(request, service, _file_name(name))
    response.headers["Location"] = f"{RECORDINGS}/{row.id}"
    return recording_resource(row)


@router.get("", responses=problem_responses("invalid-request"))
def list_recordings(request: Request, service: Service, limit: Limit = 100, before: Before = None) -> RecordingList:
    """Return the recordings, the newest first."""
    rows, following = paginate(service.store.recordings(limit + 1, before), limit, request)
    return RecordingList(recordings=[recording_resource(row) for row in rows], next=following)


@router.get("/{id}", responses=problem_responses("recording-not-found", "invalid-request"))
def get_recording(recording: Recording) -> RecordingResource:
    """Return a recording: the contents of its header, and what is in it."""
    return recording_resource(recording)


FILE: dict[int | str, dict[str, Any]] = {200: {"content": {MCAP: BINARY}}}


FILE_RESPONSES = NOT_MODIFIED | problem_responses("recording-not-found", "no-result", "invalid-request")


@router.get("/{id}/file", response_class=FileResponse, responses=FILE | FILE_RESPONSES)
def download_recording(recording: Recording, service: Service, if_none_match: IfNoneMatch) -> Response:
    """Return the MCAP file, unchanged."""
    return send_recording(service, recording, if_none_match)


def send_recording(
    service: Context, recording: RecordingRow, if_none_match: str | None, scan: str | None = None
) -> Response:
    """Return a response that sends the recording's file, or 304 if the client has it.

    Args:
        service: The service's context.
        recording: The recording.
        if_none_match: The request's header.
        scan: Id of the scan whose recording is sent. The saved file has its name. None: the name of the recording.
    """
    return send_file(
        service.store.folder.recording(recording.id),
        MCAP,
        if_none_match,
        save_as=f"{scan or recording.id}.mcap",
        sha256=recording.sha256,
        size_bytes=recording.size_bytes,
    )


def require_recording_file(service: Context, recording: RecordingRow) -> None:
    """Check that the recording's file exists and has its recorded size.

    Raises:
        ProblemError: `damaged`: The file is missing, or has another size.
    """
    stat_file(service.store.folder.recording(recording.id), size_bytes=recording.size_bytes)


@contextmanager
def _upload_slot(service: Context) -> Iterator[None]:
    """Hold one of the upload slots.

    Raises:
        ProblemError: `busy`: All slots are taken.
    """
    try:
        service.uploads.acquire_nowait()
    except WouldBlock:
        detail = f"{MAX_UPLOADS} recordings are being uploaded; try again later"
        raise ProblemError("busy", detail, {"Retry-After": "5"}, uploads=MAX_UPLOADS) from None
    try:
        yield
    finally:
        service.uploads.release()


def _file_name(given: str | None) -> str | None:
    """Return the name without folders and unprintable characters. It is only displayed."""
    last = PurePosixPath((given or "").replace("\\", "/")).name
    return "".join(character for character in last if character.isprintable()) or None


async def _store_upload(request: Request, service: Context, name: str | None) -> RecordingRow:
    recording_id = new_id()
    path = service.store.folder.incoming(f"upload-{recording_id}.mcap")
    declared = request.headers.get("content-length", "")
    length = int(declared) if declared.isdecimal() else 0
    # not for an upload above the limit, which is refused as too large when it is read
    coming = 0 if length > service.config.limits.upload_bytes else length
    await to_thread.run_sync(service.require_space, coming)
    try:
        sha256 = await _receive(request, path, service)
        row = await to_thread.run_sync(
            describe_untrusted_recording, recording_id, path, sha256, limiter=service.parsing
        )
        row = replace(row, name=name)
        await to_thread.run_sync(service.store.add_recording, row, path)
    except RecordingError as error:
        # the message has the name of the temporary file, which the sender does not know
        raise type(error)(str(error).replace(path.name, name or "the recording")) from error
    finally:
        await to_thread.run_sync(lambda: path.unlink(missing_ok=True))
    return row


async def _receive(request: Request, path: Path, service: Context) -> str:
    """Write the body to `path`, sync it and return its SHA-256. The free space is checked on the way."""
    digest, unchecked_bytes = hashlib.sha256(), 0
    file = await to_thread.run_sync(path.open, "xb")

    def write(chunk: bytes) -> None:
        nonlocal unchecked_bytes
        unchecked_bytes += len(chunk)
        if unchecked_bytes >= SPACE_CHECK_BYTES:  # the length may be undeclared, and others may take space meanwhile
            service.require_space(len(chunk))
            unchecked_bytes = 0
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
        raise ProblemError(
            "upload-incomplete", "the connection ended before the recording was complete; upload it again"
        ) from error
    finally:
        await to_thread.run_sync(file.close)
