"""The data folder: paths of its files, and the lock that admits one service.

`pointchain.sqlite3`, `recordings/ID.mcap`, `scans/ID/{model.json, cloud.ply, height-map.npz, preview.png}` and
`incoming/`, where each file is written before it is renamed to its final path.
"""

import errno
import os
import re
import shutil
from contextlib import suppress
from pathlib import Path
from typing import IO, BinaryIO

from service.states import ID_PATTERN

DATABASE = "pointchain.sqlite3"
MODEL = "model.json"
CLOUD = "cloud.ply"
HEIGHT_MAP = "height-map.npz"
PREVIEW = "preview.png"
ID = re.compile(ID_PATTERN.removeprefix("^").removesuffix("$"))


class DataFolderError(ValueError):
    """The data folder cannot be used."""

    slug = "data-folder"


class OutsideError(DataFolderError):
    """A name leads out of the data folder."""

    slug = "outside-data-folder"


class DataFolder:
    """Paths below `root`.

    A name from a request never becomes a path unchecked: an id must have the form of the store's ids, and a file must
    not be a symbolic link. The folders may be links, for example to another disk.
    """

    def __init__(self, root: Path, keep_incoming: bool = False) -> None:
        """Create the folder if needed, lock it, and empty `incoming/` unless `keep_incoming` is set.

        Raises:
            DataFolderError: The folder cannot be created or written, or another service uses it.
        """
        self.root = root
        self.database = root / DATABASE
        self._incoming = root / "incoming"
        try:
            for folder in (root, root / "recordings", root / "scans"):
                folder.mkdir(parents=True, exist_ok=True)
            self._lock = _lock(root / "lock")
            # A worker of a killed service may still write there for a moment. Its files are not used.
            self._incoming.mkdir(exist_ok=True)  # emptied, not replaced: a full disk may have no space for a folder
            if not keep_incoming:
                _empty(self._incoming)
        except OSError as error:
            raise DataFolderError(
                f"{root}: the data folder cannot be used: {error.strerror}; set data_dir to another"
            ) from error

    def close(self) -> None:
        """Release the lock of the folder."""
        self._lock.close()

    def recording(self, recording_id: str) -> Path:
        """Return the path of a recording. Raises OutsideError."""
        return _inside(self.root / "recordings", f"{_plain(recording_id)}.mcap")

    def results(self, scan_id: str) -> Path:
        """Return the folder with the results of a scan. Raises OutsideError."""
        return _inside(self.root / "scans", _plain(scan_id))

    def result(self, scan_id: str, name: str) -> Path:
        """Return the path of a file of the results of a scan. Raises OutsideError."""
        return _inside(self.results(scan_id), name)

    def incoming(self, name: str) -> Path:
        """Return a path for a file that is being written, on the same file system. Raises OutsideError."""
        return _inside(self._incoming, name)


def _empty(folder: Path) -> None:
    for path in folder.iterdir():
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path, ignore_errors=True)
        else:
            with suppress(OSError):
                path.unlink()


def open_file(path: Path) -> BinaryIO:
    """Open a file for reading. A link is not followed, also if it took the place of the file a moment ago.

    Raises:
        OSError: The file cannot be opened. ELOOP: It is a link.
    """
    flags = os.O_RDONLY | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_BINARY", 0)  # Windows has only the latter
    return os.fdopen(os.open(path, flags), "rb")


def _plain(row_id: str) -> str:
    """Return the id, which is a single part of a path."""
    if not ID.fullmatch(row_id):
        raise OutsideError(f"{row_id!r} is not an id of the store's")
    return row_id


def _inside(folder: Path, name: str) -> Path:
    """Return the path of `name` in `folder`."""
    if name in ("", ".", "..") or "/" in name or os.sep in name or "\0" in name:
        raise OutsideError(f"{name!r} is not the name of a file in the data folder")
    path = folder / name
    if path.is_symlink():
        raise OutsideError(f"{path} is a link: it leads to another place, so it is not used")
    return path


def _lock(path: Path) -> IO[bytes]:
    """Lock the folder: two services in it would mark each other's scans as interrupted."""
    file = path.open("ab")
    try:
        import fcntl
    except ImportError:  # Not POSIX: the folder goes without a lock.
        return file
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        file.close()
        if error.errno not in (errno.EWOULDBLOCK, errno.EACCES):
            raise
        raise DataFolderError(
            f"{path.parent}: another service uses this data folder; stop it, or set another data_dir"
        ) from error
    return file
