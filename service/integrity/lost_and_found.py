"""The folder that keeps everything that a repair takes out of the data folder. Nothing that holds data is deleted."""

import os
import shutil
from pathlib import Path

from calibration.atomic_write import sync_folder
from service.storage.database import new_id, now

LOST = "lost+found"


class LostAndFound:
    """The folder DATA_DIR/lost+found/STAMP of one repair.

    It is made when the first item is kept. `what-is-here.txt` in it has one line for each file or folder.
    """

    def __init__(self, root: Path) -> None:
        self._root = root
        self.folder = root / LOST / new_id()

    def move(self, path: Path, why: str) -> Path:
        """Move a file or folder here.

        Args:
            path: File or folder.
            why: Reason, for `what-is-here.txt`.

        Returns:
            The new path.

        Raises:
            OSError: The file cannot be moved.
        """
        kept = self._free_path(path)
        shutil.move(path, kept)  # not a rename, because the folder of results may be on another disk
        sync_folder(self.folder)
        sync_folder(path.parent)
        self._note(kept.name, path, why)
        return kept

    def copy(self, path: Path, why: str) -> Path:
        """Copy a file here; the original stays where it is.

        Args:
            path: File.
            why: Reason, for `what-is-here.txt`.

        Returns:
            Path of the copy.

        Raises:
            OSError: The file cannot be copied.
        """
        kept = self._free_path(path)
        try:
            shutil.copy2(path, kept)
            with kept.open("rb+") as file:
                os.fsync(file.fileno())
        except OSError:
            kept.unlink(missing_ok=True)  # a full disk leaves an incomplete copy
            raise
        sync_folder(self.folder)
        self._note(kept.name, path, why)
        return kept

    def _free_path(self, path: Path) -> Path:
        if not self.folder.exists():
            self.folder.mkdir(parents=True)
            sync_folder(self.folder.parent)
            sync_folder(self._root)
        free, number = self.folder / path.name, 1
        while free.exists() or free.is_symlink():
            number += 1
            free = self.folder / f"{number}-{path.name}"
        return free

    def _note(self, name: str, original: Path, why: str) -> None:
        with (self.folder / "what-is-here.txt").open("a") as file:
            file.write(f"{now()} {name} from {original}: {why}\n")
