"""Nothing is begun that the disk may not have room for; and nothing is removed to make room."""

import shutil
from pathlib import Path

from service.errors import ServiceError


def require_space(folder: Path, least_bytes: int, coming_bytes: int = 0) -> None:
    """Lets pass what may begin: `least_bytes` are free, and stay free when `coming_bytes` have come.

    Raises:
        ServiceError: `storage-full`, with how much is free and how much is needed.
        OSError: the folder cannot be looked at.
    """
    free = shutil.disk_usage(folder).free
    needed = least_bytes + coming_bytes
    if free < needed:
        raise ServiceError(
            "storage-full",
            f"{_size(free)} are free in the data folder and {_size(needed)} are needed: free some, have old scans "
            "removed (retention), or set limits.min_free_bytes lower; nothing is removed by itself to make room",
        )


def _size(count: int) -> str:
    return f"{count / 2**20:.1f} MiB"
