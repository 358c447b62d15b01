"""Files as answers."""

import os
import stat
from pathlib import Path
from typing import Annotated

from fastapi import Depends, Header, Request
from fastapi.responses import FileResponse, Response
from starlette.types import Receive, Scope, Send

from service.api.etags import matches, tag_of_file, tag_of_hash
from service.problems.problem_error import ProblemError

AT_ONCE_BYTES = 1 << 20
"""A file up to this is read in one go, by the thread that has looked for it; larger ones piece by piece."""
NOT_MODIFIED: dict[int | str, dict[str, str]] = {304: {"description": "The client has it already"}}
"""What an operation with an ETag declares besides."""


async def _if_none_match(
    request: Request,
    _: Annotated[str | None, Header(alias="If-None-Match", description="ETags of what the client has already")] = None,
) -> str | None:
    return ", ".join(request.headers.getlist("if-none-match")) or None


IfNoneMatch = Annotated[str | None, Depends(_if_none_match)]
"""The request's header, all its lines together."""


def present(path: Path, sha256: str | None = None, size_bytes: int | None = None) -> tuple[os.stat_result, str]:
    """A file that is there, and its ETag: of its hash where that is known.

    Raises:
        ProblemError: `no-result`, there is no such file; `damaged`, it is gone, or has not the size that it was
            written with.
    """
    try:
        found = path.stat()
    except (FileNotFoundError, NotADirectoryError):
        found = None
    if found is None or not stat.S_ISREG(found.st_mode):
        if size_bytes is not None:
            raise ProblemError("damaged", f"{path.name} is gone from the data folder: run `pointchain doctor`")
        raise ProblemError("no-result", f"there is no {path.name}")
    if size_bytes is not None and found.st_size != size_bytes:
        raise ProblemError(
            "damaged",
            f"{path.name} has {found.st_size} bytes and was written with {size_bytes}: run `pointchain doctor`",
        )
    return found, tag_of_file(found) if sha256 is None else tag_of_hash(sha256)


def read_whole(path: Path, size_bytes: int) -> bytes:
    """The content of a file that had this size a moment ago.

    Raises:
        ProblemError: `no-result`, it is gone; `damaged`, it has another size.
    """
    try:
        content = path.read_bytes()
    except FileNotFoundError:  # removed a moment ago
        raise ProblemError("no-result", "the file is gone from the data folder") from None
    if len(content) != size_bytes:
        raise ProblemError("damaged", f"{path.name} is being changed: run `pointchain doctor`")
    return content


class WholeFile(FileResponse):
    """A file that is always sent whole: a Range refused by Starlette would not be answered by a problem."""

    def __init__(self, path: Path, media_type: str, filename: str | None, found: os.stat_result, etag: str) -> None:
        """`filename` is what a browser saves it as; None shows it instead. `found` and `etag` as `present` has them."""
        headers = {"accept-ranges": "none", "etag": etag}
        super().__init__(path, media_type=media_type, filename=filename, headers=headers, stat_result=found)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Sends the file as if no Range had been asked for."""
        headers = [(name, value) for name, value in scope["headers"] if name.lower() != b"range"]
        await super().__call__({**scope, "headers": headers}, receive, send)


def send_file(
    path: Path,
    media_type: str,
    if_none_match: str | None = None,
    *,
    save_as: str | None = None,
    sha256: str | None = None,
    size_bytes: int | None = None,
) -> Response:
    """The answer that sends a file, or says that the client has it. Raises as `present`."""
    found, etag = present(path, sha256, size_bytes)
    if matches(if_none_match, etag):
        return not_modified(etag)
    file = WholeFile(path, media_type, save_as, found, etag)
    if found.st_size > AT_ONCE_BYTES:
        return file
    return Response(read_whole(path, found.st_size), headers=dict(file.headers))


def not_modified(etag: str) -> Response:
    """The client has it already."""
    return Response(status_code=304, headers={"etag": etag})
