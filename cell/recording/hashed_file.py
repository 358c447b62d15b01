"""A new file that knows the hash of what goes into it, so that nothing has to be read again."""

import hashlib
import os
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Written:
    """A range of bytes that was written to a file."""

    offset_bytes: int
    """Offset of the first byte."""
    size_bytes: int
    """Number of bytes."""
    sha256: str
    """SHA-256 of these bytes, hexadecimal."""


class HashedFile:
    """A new file, written from its beginning to its end, piece by piece."""

    def __init__(self, path: Path) -> None:
        """Raises FileExistsError; OSError when it cannot be created."""
        self._file = path.open("xb")
        self._begin, self._end = 0, 0
        self._digest = hashlib.sha256()

    @property
    def closed(self) -> bool:
        """Takes no more."""
        return self._file.closed

    def write(self, data: bytes) -> int:
        """Adds to the piece."""
        count = self._file.write(data)
        self._digest.update(data)
        self._end += count
        return count

    def tell(self) -> int:
        """How many bytes were written so far."""
        return self._end

    def flush(self) -> None:
        """Hands all to the system."""
        self._file.flush()

    def sync(self) -> Written:
        """Ends the piece: what was written since the last one. It is on the disk when this returns."""
        self._file.flush()
        os.fsync(self._file.fileno())
        piece = Written(self._begin, self._end - self._begin, self._digest.hexdigest())
        self._begin, self._digest = self._end, hashlib.sha256()
        return piece

    def abandon(self) -> None:
        """Closes the file without its buffer: after a failed write that would try, and fail, to write its rest."""
        self._file.raw.close()
