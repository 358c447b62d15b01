"""The data folder: where each file lies, and that only one service uses it.

`pointchain.sqlite3`, `recordings/ID.mcap`, `scans/ID/{model.json, cloud.ply, preview.png}` and `incoming/`,
where everything is written before it is renamed to its place.
"""

import errno
import shutil
from pathlib import Path
from typing import IO

MODEL = "model.json"
CLOUD = "cloud.ply"
PREVIEW = "preview.png"


class DataFolderError(ValueError):
    """A data folder that cannot be used."""

    slug = "data-folder"


class DataFolder:
    """Paths under `root`. Ids must be the store's own: no name from outside ever becomes part of a path."""

    def __init__(self, root: Path) -> None:
        """Makes the folder if need be, locks it, and empties `incoming/`.

        Raises:
            DataFolderError: it cannot be made or written, or another service uses it.
        """
        self.root = root
        self.database = root / "pointchain.sqlite3"
        self._incoming = root / "incoming"
        try:
            for folder in (root, root / "recordings", root / "scans"):
                folder.mkdir(parents=True, exist_ok=True)
            self._lock = _lock(root / "lock")
            # A worker of a killed service may still write there for a moment; nothing looks at it.
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
        """The file of a recording."""
        return self.root / "recordings" / f"{recording_id}.mcap"

    def results(self, scan_id: str) -> Path:
        """The folder of a scan's results."""
        return self.root / "scans" / scan_id

    def incoming(self, name: str) -> Path:
        """Where something is written before it goes to its place; on the same file system."""
        return self._incoming / name


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
