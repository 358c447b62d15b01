"""Responses that send files, and entity tags (RFC 9110): a client with the current version gets 304 instead."""

import os
import re
import stat
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

from fastapi import Depends, Header, Request
from fastapi.responses import FileResponse, Response, StreamingResponse

from service.problems.problem_error import ProblemError
from service.storage.data_folder import open_file

_TAG = re.compile(r'(?:W/)?("[\x21\x23-\x7e\x80-\xff]*")')
MAX_BUFFERED_BYTES = 1 << 20
"""Size up to which a file is read at once, by the thread that found it. Larger files are sent in chunks."""
CHUNK_BYTES = 1 << 16
NOT_MODIFIED: dict[int | str, dict[str, str]] = {304: {"description": "The client has the current version"}}
"""OpenAPI response of an operation with an ETag, in addition to its others."""


async def _if_none_match(
    request: Request,
    _: Annotated[
        str | None, Header(alias="If-None-Match", description="ETags of the versions that the client has")
    ] = None,
) -> str | None:
    return ", ".join(request.headers.getlist("if-none-match")) or None


IfNoneMatch = Annotated[str | None, Depends(_if_none_match)]
"""The request's header If-None-Match, with all its lines joined."""


def stat_file(path: Path, sha256: str | None = None, size_bytes: int | None = None) -> tuple[os.stat_result, str]:
    """Return the status of a file that exists, and its ETag.

    Args:
        path: The file.
        sha256: Hash of the file, from which the ETag is made. None: the ETag is made from size and modification time.
        size_bytes: Size that the file was written with. None: not recorded.

    Raises:
        ProblemError: `no-result`: There is no such file. `damaged`: A file of recorded size is missing, or has another
            size.
    """
    try:
        file_stat = path.lstat()  # a link is not a file: it may lead anywhere
    except (FileNotFoundError, NotADirectoryError):
        file_stat = None
    if file_stat is None or not stat.S_ISREG(file_stat.st_mode):
        if size_bytes is not None:
            raise ProblemError(
                "damaged", f"{path.name} is gone from the data folder: run `pointchain doctor`", file=path.name
            )
        raise ProblemError("no-result", f"there is no {path.name}", file=path.name)
    if size_bytes is not None and file_stat.st_size != size_bytes:
        raise ProblemError(
            "damaged",
            f"{path.name} has {file_stat.st_size} bytes and was written with {size_bytes}: run `pointchain doctor`",
            file=path.name,
        )
    return file_stat, tag_of_file(file_stat) if sha256 is None else tag_of_hash(sha256)


def read_file(path: Path, size_bytes: int) -> bytes:
    """Return the content of a file that had this size a moment ago.

    Raises:
        ProblemError: `no-result`: The file was removed. `damaged`: The file has another size.
    """
    try:
        with open_file(path) as file:
            content = file.read()
    except FileNotFoundError:  # removed a moment ago
        raise ProblemError("no-result", f"{path.name} is gone from the data folder", file=path.name) from None
    if len(content) != size_bytes:
        raise ProblemError("damaged", f"{path.name} is being changed: run `pointchain doctor`", file=path.name)
    return content


def _chunks(path: Path) -> Iterator[bytes]:
    """Yield the content of a file, piece by piece."""
    with open_file(path) as file:
        while chunk := file.read(CHUNK_BYTES):
            yield chunk


def send_file(
    path: Path,
    media_type: str,
    if_none_match: str | None = None,
    *,
    save_as: str | None = None,
    sha256: str | None = None,
    size_bytes: int | None = None,
) -> Response:
    """Return a response that sends a file, or 304 if the client has it.

    Args:
        path: The file.
        media_type: Its media type.
        if_none_match: The request's header If-None-Match.
        save_as: Name under which a browser saves the file. None: the browser shows it.
        sha256: As for `stat_file`.
        size_bytes: As for `stat_file`.

    Raises:
        ProblemError: As for `stat_file` and `read_file`.
    """
    file_stat, etag = stat_file(path, sha256, size_bytes)
    if matches(if_none_match, etag):
        return not_modified_response(etag)
    etags = {"accept-ranges": "none", "etag": etag}
    # Only its headers are used: it would follow a link, and refuse a bad Range without a problem document.
    headers = dict(FileResponse(path, 200, etags, media_type, filename=save_as, stat_result=file_stat).headers)
    if file_stat.st_size > MAX_BUFFERED_BYTES:
        return StreamingResponse(_chunks(path), headers=headers)
    return Response(read_file(path, file_stat.st_size), headers=headers)


def not_modified_response(etag: str) -> Response:
    """Return the response 304, for a client that has the current version."""
    return Response(status_code=304, headers={"etag": etag})


def matches(if_none_match: str | None, etag: str) -> bool:
    """Whether the header If-None-Match lists the strong tag `etag`. Weak comparison, as the RFC requires."""
    if if_none_match is None:
        return False
    return if_none_match.strip() == "*" or etag in _TAG.findall(if_none_match)


def tag_of_hash(sha256: str) -> str:
    """Return the entity tag of content with a known hash."""
    return f'"{sha256}"'


def tag_of_file(stat: os.stat_result) -> str:
    """Return the entity tag of a file that is written once, from its size and its modification time."""
    return f'"{stat.st_size:x}-{stat.st_mtime_ns:x}"'
