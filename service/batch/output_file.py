"""The file of a run's lines, which can be stopped, or killed, at any moment and gone on with.

While a run goes on its lines are in FILE.part, each on the disk before the next one. FILE is written when all
recordings have theirs, in one step and in the order asked for, so it is whole whenever it is there.
"""

import json
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

from service.batch.errors import ArchiveError
from service.batch.formats import lines_of, write_lines
from service.batch.recognise_file import Asked, Line, sha256_of

TRIED_AGAIN = ("recording-unreadable", "file", "internal", "recognition-crashed")
"""Errors that are the machine's or ours rather than the recording's: the next run tries those again."""


@dataclass(frozen=True)
class _Known:
    """A line of the part file."""

    offset_bytes: int
    size_bytes: int
    sha256: str | None
    """Of the recording."""
    error: str | None
    """Its slug."""


class Output:
    """The lines of a run, those of earlier ones among them."""

    def __init__(self, path: Path, part: IO[bytes], asked: Asked) -> None:
        self._path, self._part, self._asked = path, part, asked
        self._known: dict[str, _Known] = {}
        self.finished = False
        """All is in its place."""

    @property
    def begun(self) -> bool:
        """There are lines that would be lost without the part file."""
        return self._part.seek(0, os.SEEK_END) > 0

    def others(self, files: Sequence[str]) -> int:
        """How many lines there are of recordings that were not asked for now."""
        return len(self._known.keys() - set(files))

    def failures(self, files: Sequence[str]) -> int:
        """How many of them have no model."""
        return sum(self._known[file].error is not None for file in files)

    def left(self, files: Sequence[str]) -> list[str]:
        """Which of them have no line yet, or one of another content, or one that is worth another trial.

        A model of a file that is gone stays. What was done under another name has its line under this one too, on the
        disk on return. Raises OSError.
        """
        done = {known.sha256: known for known in self._known.values() if known.error not in TRIED_AGAIN}
        left = []
        for file in files:
            sha256 = sha256_of(Path(file))
            known = self._known.get(file)
            if known is not None and known.error not in TRIED_AGAIN and sha256 in (known.sha256, None):
                continue
            if sha256 is not None and sha256 in done:
                self._take_over(done[sha256], file)
            else:
                left.append(file)
        self._sync()
        return left

    def add(self, line: Line) -> None:
        """Keeps a line: on the disk on return. Raises OSError."""
        self._take(line.text.encode(), json.loads(line.text))
        self._sync()

    def finish(self, files: Sequence[str]) -> None:
        """Writes the lines to their place: what was there of other files, then `files`. Raises OSError."""
        wanted = {file: self._known[file].sha256 for file in files}
        under = {sha256: file for file, sha256 in wanted.items()}
        for name, known in list(self._known.items()):
            if name not in wanted and known.sha256 in under and _same_or_gone(name, under[known.sha256]):
                del self._known[name]
        order = [*(name for name in self._known if name not in wanted), *files]
        write_lines(self._path, (self._line(self._known[file]) for file in order))
        self.finished = True

    def _sync(self) -> None:
        self._part.flush()
        os.fsync(self._part.fileno())

    def _take_over(self, known: _Known, file: str) -> None:
        """The line as one of `file`, which has the same content."""
        document = json.loads(self._line(known))
        document["recording"]["file"] = file
        if "error" in document:
            document["error"]["file"] = file
        self._take(json.dumps(document, allow_nan=False).encode(), document)

    def _take(self, text: bytes, document: dict[str, Any]) -> None:
        offset = self._part.seek(0, os.SEEK_END)
        self._part.write(text + b"\n")
        self._remember(document, offset, len(text))

    def _parsed(self, text: str) -> dict[str, Any]:
        """A line that this run may have made. Raises ArchiveError."""
        try:
            document = json.loads(text)
            asked, _ = dict(document["asked"]), document["recording"]["sha256"]
        except (ValueError, KeyError, TypeError) as error:
            raise ArchiveError(f"{self._path} is there, and no output of such a run: name another file") from error
        ours = self._asked.to_json()
        if asked != ours:
            differing = [key for key in {**ours, **asked} if asked.get(key) != ours.get(key)]
            what = ", ".join(f"{key} {asked.get(key)}, now {ours.get(key)}" for key in differing)
            raise ArchiveError(f"{self._path} has models that were asked for otherwise ({what}): name another file")
        return document

    def _remember(self, document: dict[str, Any], offset: int, size: int) -> None:
        recording, error = document["recording"], document.get("error")
        slug = None if error is None else error["type"].removeprefix("urn:pointchain:")
        self._known[recording["file"]] = _Known(offset, size, recording["sha256"], slug)

    def _line(self, known: _Known) -> str:
        self._part.seek(known.offset_bytes)
        return self._part.read(known.size_bytes).decode()

    def load(self) -> None:
        """Reads what earlier runs left: of a line that one was killed in nothing is kept.

        Raises:
            ArchiveError: it is no output, or of a run that was asked otherwise.
        """
        self._part.seek(0)
        offset = 0
        for text in self._part:
            if not text.endswith(b"\n"):
                break
            self._remember(self._parsed(text.decode()), offset, len(text) - 1)
            offset += len(text)
        self._part.truncate(offset)
        # Each time, since a run may be killed here too: what is not in the part file now would be lost in the end.
        for text in lines_of(self._path) if self._path.exists() else ():
            document = self._parsed(text)
            if document["recording"]["file"] not in self._known:
                self._take(text.encode(), document)


@contextmanager
def output(path: Path, asked: Asked) -> Iterator[Output]:
    """The output at `path`, with what is there of an earlier run; `finish` must be called in the block.

    Raises:
        ArchiveError: what is there is of another kind, was asked for otherwise, or is being written; or the file
            cannot be written.
    """
    part_path = path.with_name(f"{path.name}.part")
    try:
        with _locked(part_path, path) as part:
            lines = Output(path, part, asked)
            try:
                lines.load()
                yield lines
            finally:
                if lines.finished or not lines.begun:
                    part_path.unlink()
    except OSError as error:
        raise ArchiveError(f"{error.filename or path} cannot be written: {error.strerror or error}") from error


def _same_or_gone(name: str, file: str) -> bool:
    """Whether `name` is only another way to `file`, or where it was before."""
    try:
        return Path(name).samefile(file)
    except OSError:
        return not Path(name).exists()


def _locked(part_path: Path, path: Path) -> IO[bytes]:
    """The part file, open, for this run alone. Raises ArchiveError, OSError."""
    while True:
        part = part_path.open("a+b")
        try:
            _lock(part, path)
            if os.fstat(part.fileno()).st_nlink:
                return part
        except BaseException:
            part.close()
            raise
        part.close()  # another run has just ended, and removed it


def _lock(part: IO[bytes], path: Path) -> None:
    try:
        import fcntl
    except ImportError:  # not POSIX: nobody is kept out
        return
    try:
        fcntl.flock(part, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        raise ArchiveError(f"{path} is being written by another run") from error
