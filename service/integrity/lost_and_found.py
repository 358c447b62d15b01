"""Where the doctor puts what it takes out of the store: nothing that holds data is ever removed."""

import json
import os
import shutil
from pathlib import Path
from typing import Any

from calibration.atomic_write import sync_folder
from service.storage.database import new_id, now

LOST = "lost+found"


class LostAndFound:
    """DATA_DIR/lost+found/STAMP, made when the first thing is put there, with a line for each in `what-is-here.txt`."""

    def __init__(self, root: Path) -> None:
        self._root = root
        self.folder = root / LOST / new_id()

    def move(self, path: Path, why: str) -> Path:
        """Puts a file or folder aside; where it is then. Raises OSError."""
        place = self._place(path)
        shutil.move(path, place)  # the folder of results, say, may be on another disk
        sync_folder(self.folder)
        sync_folder(path.parent)
        self._note(place.name, path, why)
        return place

    def copy(self, path: Path, why: str) -> Path:
        """The same, but the file stays where it is, too. Raises OSError."""
        place = self._place(path)
        shutil.copy2(path, place)
        with place.open("rb+") as file:
            os.fsync(file.fileno())
        sync_folder(self.folder)
        self._note(place.name, path, why)
        return place

    def keep_row(self, table: str, values: dict[str, Any], why: str) -> None:
        """Keeps a row's content, as a line of `rows.jsonl`. Raises OSError."""
        self._make_folder()
        line = json.dumps({"table": table, "why": why, "row": values}, default=_text)
        with (self.folder / "rows.jsonl").open("a") as file:
            file.write(line + "\n")
            file.flush()
            os.fsync(file.fileno())  # it is deleted from the database next
        sync_folder(self.folder)

    def _make_folder(self) -> None:
        if not self.folder.exists():
            self.folder.mkdir(parents=True)
            sync_folder(self.folder.parent)
            sync_folder(self._root)

    def _place(self, path: Path) -> Path:
        self._make_folder()
        place, number = self.folder / path.name, 1
        while place.exists() or place.is_symlink():
            number += 1
            place = self.folder / f"{number}-{path.name}"
        return place

    def _note(self, name: str, was: Path, why: str) -> None:
        with (self.folder / "what-is-here.txt").open("a") as file:
            file.write(f"{now()} {name} from {was}: {why}\n")


def _text(value: object) -> str:
    return value.hex() if isinstance(value, bytes) else str(value)
