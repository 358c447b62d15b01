"""The data folder: where each file lies, and that only one service uses it.

`pointchain.sqlite3`, `recordings/ID.mcap`, `scans/ID/{model.json, cloud.ply, preview.png}` and `incoming/`,
where everything is written before it is renamed to its place.
"""

import errno
import os
import re
import shutil
from pathlib import Path
from typing import IO

from service.states import ID_PATTERN

DATABASE = "pointchain.sqlite3"
MODEL = "model.json"
CLOUD = "cloud.ply"
PREVIEW = "preview.png"
ID = re.compile(ID_PATTERN.removeprefix("^").removesuffix("$"))


class DataFolderError(ValueError):
    """A data folder that cannot be used."""

    slug = "data-folder"


class OutsideError(DataFolderError):
    """A name that leads out of the data folder."""

    slug = "outside-data-folder"


class DataFolder:
    """Paths under `root`. No name from outside ever becomes part of a path: ids must have the form of the store's own,
    and what has their name must not lead elsewhere. The folders may: an administrator may have put them on another
    disk."""

    def __init__(self, root: Path, keep_incoming: bool = False) -> None:
        """Makes the folder if need be, locks it, and empties `incoming/` unless that is to be kept.

        Raises:
            DataFolderError: it cannot be made or written, or another service uses it.
        """
        self.root = root
        self.database = root / DATABASE
        self._incoming = root / "incoming"
        try:
            for folder in (root, root / "recordings", root / "scans"):
                folder.mkdir(parents=True, exist_ok=True)
            self._lock = _lock(root / "lock")
            # A worker of a killed service may still write there for a moment; nothing looks at it.
            if not keep_incoming:
                shutil.rmtree(self._incoming, ignore_errors=True)
            self._incoming.mkdir(exist_ok=True)
        except OSError as error:
            raise DataFolderError(
                f"{root}: the data folder cannot be used: {error.strerror}; set data_dir to another"
            ) from error

    def close(self) -> None:
        """Lets another service use the folder."""
        self._lock.close()

    def recording(self, recording_id: str) -> Path:
        """The file of a recording. Raises OutsideError."""
        return _inside(self.root / "recordings", f"{_plain(recording_id)}.mcap")

    def results(self, scan_id: str) -> Path:
        """The folder of a scan's results. Raises OutsideError."""
        return _inside(self.root / "scans", _plain(scan_id))

    def incoming(self, name: str) -> Path:
        """Where something is written before it goes to its place; on the same file system. Raises OutsideError."""
        return _inside(self._incoming, name)


def _plain(row_id: str) -> str:
    """The id, which cannot be more than one part of a path."""
    if not ID.fullmatch(row_id):
        raise OutsideError(f"{row_id!r} is not an id of the store's")
    return row_id


def _inside(folder: Path, name: str) -> Path:
    """What is called `name` in `folder`."""
    if name in ("", ".", "..") or "/" in name or os.sep in name or "\0" in name:
        raise OutsideError(f"{name!r} is not the name of a file in the data folder")
    path = folder / name
    if path.is_symlink():
        raise OutsideError(f"{path} is a link: it leads to another place, so it is not used")
    return path


def _lock(path: Path) -> IO[bytes]:
    """Two services in one folder would take each other's scans for interrupted ones."""
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
