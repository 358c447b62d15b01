"""Output file of a run, which can be stopped or killed at any moment and continued later.

During a run its lines are in FILE.part. Each line is on the disk before the next one starts. FILE is written when all
recordings have a line, in one step and in the requested order. A file with this name is therefore always complete.
"""

import json
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

from recognition.model.model import SCHEMA
from recognition.request import RecognitionRequest
from service.batch.errors import BatchError
from service.batch.formats import read_lines, write_lines
from service.batch.recognise_file import RecordingLine, hash_recording, request_document

RETRIED_ERRORS = ("recording-unreadable", "file", "internal", "recognition-crashed")
"""Errors of the machine or of Pointchain, not of the recording. The next run tries these recordings again."""


@dataclass(frozen=True)
class _PartLine:
    """Position and key values of a line in the part file."""

    offset_bytes: int
    size_bytes: int
    sha256: str | None
    """SHA-256 of the recording."""
    error: str | None
    """Slug of the error. None: the line holds a model."""


class OutputFile:
    """The lines of a run and of the earlier runs that it continues."""

    def __init__(self, path: Path, part: IO[bytes], request: RecognitionRequest) -> None:
        self._path, self._part, self._request = path, part, request
        self._lines: dict[str, _PartLine] = {}
        self.finished = False
        """Whether the output file holds all lines."""

    @property
    def has_lines(self) -> bool:
        """Whether the part file has lines, which would be lost with it."""
        return self._part.seek(0, os.SEEK_END) > 0

    def count_others(self, files: Sequence[str]) -> int:
        """Return the number of lines of recordings other than `files`."""
        return len(self._lines.keys() - set(files))

    def count_failures(self, files: Sequence[str]) -> int:
        """Return how many of `files` have no model."""
        return sum(self._lines[file].error is not None for file in files)

    def remaining(self, files: Sequence[str]) -> list[str]:
        """Return the files that must be recognised: without a line, with changed content, or with a retried error.

        The line of a file that no longer exists is kept. If another file with the same content has a line, it is
        copied under the name of this file. The copies are on the disk when this returns.

        Args:
            files: Names of the recordings.

        Raises:
            OSError: The part file cannot be written.
        """
        done = {line.sha256: line for line in self._lines.values() if line.error not in RETRIED_ERRORS}
        remaining = []
        for file in files:
            sha256 = hash_recording(Path(file))
            line = self._lines.get(file)
            if line is not None and line.error not in RETRIED_ERRORS and sha256 in (line.sha256, None):
                continue
            if sha256 is not None and sha256 in done:
                self._copy_for(done[sha256], file)
            else:
                remaining.append(file)
        self._sync()
        return remaining

    def add(self, line: RecordingLine) -> None:
        """Add a line. It is on the disk when this returns.

        Raises:
            OSError: The part file cannot be written.
        """
        self._append(line.text.encode(), json.loads(line.text))
        self._sync()

    def finish(self, files: Sequence[str]) -> None:
        """Write the output file: first the lines of other recordings, then those of `files`.

        Lines of other names for the same recordings are dropped.

        Args:
            files: Names of the recordings, in the requested order.

        Raises:
            OSError: The file cannot be written.
        """
        requested = {file: self._lines[file].sha256 for file in files}
        file_by_hash = {sha256: file for file, sha256 in requested.items()}
        for name, line in list(self._lines.items()):
            if (
                name not in requested
                and line.sha256 in file_by_hash
                and _is_alias_or_missing(name, file_by_hash[line.sha256])
            ):
                del self._lines[name]
        order = [*(name for name in self._lines if name not in requested), *files]
        write_lines(self._path, (self._text_of(self._lines[file]) for file in order))
        self.finished = True

    def _sync(self) -> None:
        self._part.flush()
        os.fsync(self._part.fileno())

    def _copy_for(self, line: _PartLine, file: str) -> None:
        """Append a copy of a line for `file`, which has the same content."""
        document = json.loads(self._text_of(line))
        document["recording"]["file"] = file
        if "error" in document:
            document["error"]["file"] = file
        self._append(json.dumps(document, allow_nan=False).encode(), document)

    def _append(self, text: bytes, document: dict[str, Any]) -> None:
        offset = self._part.seek(0, os.SEEK_END)
        self._part.write(text + b"\n")
        self._register(document, offset, len(text))

    def _parse(self, text: str) -> dict[str, Any]:
        """Return the document of a line.

        Raises:
            BatchError: The line is not of `pointchain recognise`, has another schema, or was made for another request.
        """
        try:
            document = json.loads(text)
            earlier, _, schema = dict(document["request"]), document["recording"]["sha256"], document["schema"]
        except (ValueError, KeyError, TypeError) as error:
            raise BatchError(
                f"{self._path} exists and is not the output of pointchain recognise: name another file"
            ) from error
        if schema != SCHEMA:
            raise BatchError(f"{self._path} has models of schema {schema}, now {SCHEMA}: name another file")
        requested = request_document(self._request)
        if earlier != requested:
            differing = [key for key in {**requested, **earlier} if earlier.get(key) != requested.get(key)]
            what = ", ".join(f"{key} {earlier.get(key)}, now {requested.get(key)}" for key in differing)
            raise BatchError(f"{self._path} has models of other settings ({what}): name another file")
        return document

    def _register(self, document: dict[str, Any], offset: int, size: int) -> None:
        recording, error = document["recording"], document.get("error")
        slug = None if error is None else error["type"].removeprefix("urn:pointchain:")
        self._lines[recording["file"]] = _PartLine(offset, size, recording["sha256"], slug)

    def _text_of(self, line: _PartLine) -> str:
        self._part.seek(line.offset_bytes)
        return self._part.read(line.size_bytes).decode()

    def load(self) -> None:
        """Read the lines of earlier runs. An incomplete last line, left by a killed run, is cut off.

        Raises:
            BatchError: A file is not the output of `pointchain recognise`, or was made for another request.
        """
        self._part.seek(0)
        offset = 0
        for text in self._part:
            if not text.endswith(b"\n"):
                break
            self._register(self._parse(text.decode()), offset, len(text) - 1)
            offset += len(text)
        self._part.truncate(offset)
        # finish() writes only lines of the part file, so every run copies the missing ones: the last may be killed here
        for text in read_lines(self._path) if self._path.exists() else ():
            document = self._parse(text)
            if document["recording"]["file"] not in self._lines:
                self._append(text.encode(), document)


@contextmanager
def open_output(path: Path, request: RecognitionRequest) -> Iterator[OutputFile]:
    """Open the output at `path` with the lines of earlier runs. The caller must call `finish` in the block.

    Args:
        path: Output file.
        request: How the recordings are recognised.

    Raises:
        BatchError: The file is something else, was made for another request, is being written by another run, or
            cannot be written.
    """
    part_path = path.with_name(f"{path.name}.part")
    try:
        with _open_locked(part_path, path) as part:
            output = OutputFile(path, part, request)
            try:
                output.load()
                yield output
            finally:
                if output.finished or not output.has_lines:
                    part_path.unlink()
    except OSError as error:
        raise BatchError(f"{error.filename or path} cannot be written: {error.strerror or error}") from error


def _is_alias_or_missing(name: str, file: str) -> bool:
    """Return whether `name` is another path to `file`, or no longer exists."""
    try:
        return Path(name).samefile(file)
    except OSError:
        return not Path(name).exists()


def _open_locked(part_path: Path, path: Path) -> IO[bytes]:
    """Open and lock the part file.

    Raises:
        BatchError: Another run has locked it.
        OSError: It cannot be opened.
    """
    while True:
        part = part_path.open("a+b")
        try:
            _lock(part, path)
            if os.fstat(part.fileno()).st_nlink:
                return part
        except BaseException:
            part.close()
            raise
        part.close()  # another run has just ended and removed this file


def _lock(part: IO[bytes], path: Path) -> None:
    try:
        import fcntl
    except ImportError:  # only POSIX has this lock
        return
    try:
        fcntl.flock(part, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        raise BatchError(f"{path} is being written by another run: wait for it, or name another file") from error
