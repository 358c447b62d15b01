"""A new file that hashes its content while it is written."""

import hashlib
import os
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class WrittenRange:
    """A range of bytes that was written to a file."""

    offset_bytes: int
    """Offset of the first byte."""
    size_bytes: int
    """Number of bytes."""
    sha256: str
    """SHA-256 of these bytes, hexadecimal."""


class HashedFile:
    """A new file that is written piece by piece, each with its hash."""

    def __init__(self, path: Path) -> None:
        """Create the file. Raise FileExistsError if it exists, and OSError if it cannot be created."""
        self._file = path.open("xb")
        self._begin, self._end = 0, 0
        self._digest = hashlib.sha256()

    @property
    def closed(self) -> bool:
        """Whether the file is closed."""
        return self._file.closed

    def write(self, data: bytes) -> int:
        """Append data to the current piece, and return its size."""
        count = self._file.write(data)
        self._digest.update(data)
        self._end += count
        return count

    def tell(self) -> int:
        """Return the number of bytes that were written so far."""
        return self._end

    def flush(self) -> None:
        """Pass all data to the operating system."""
        self._file.flush()

    def sync(self) -> WrittenRange:
        """End the current piece and sync it to the disk. Return its range and hash."""
        self._file.flush()
        os.fsync(self._file.fileno())
        piece = WrittenRange(self._begin, self._end - self._begin, self._digest.hexdigest())
        self._begin, self._digest = self._end, hashlib.sha256()
        return piece

    def abandon(self) -> None:
        """Close the file without writing its buffer, which would fail again after a failed write."""
        self._file.raw.close()
