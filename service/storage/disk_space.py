"""The check for free disk space before an operation begins."""

import shutil
from pathlib import Path

from service.errors import ServiceError


def require_space(folder: Path, min_free_bytes: int, incoming_bytes: int = 0) -> None:
    """Check that enough space is free. Nothing is removed to make room.

    Args:
        folder: A folder on the disk.
        min_free_bytes: Space that must stay free.
        incoming_bytes: Space that the operation takes.

    Raises:
        ServiceError: `storage-full`, with the free and the needed space.
        OSError: The folder cannot be read.
    """
    free = shutil.disk_usage(folder).free
    needed = min_free_bytes + incoming_bytes
    if free < needed:
        raise ServiceError(
            "storage-full",
            f"{_size(free)} are free in the data folder and {_size(needed)} are needed: free some, have old scans "
            "removed (retention), or set limits.min_free_bytes lower; nothing is removed by itself to make room",
            free_bytes=free,
            needed_bytes=needed,
        )


def _size(count: int) -> str:
    return f"{count / 2**20:.1f} MiB"
