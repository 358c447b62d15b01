"""Plain files: read up to a size, and written so that they survive a loss of power."""

import os
from contextlib import suppress
from functools import partial
from pathlib import Path

from calibration.errors import CalibrationFolderError


class TooLargeError(ValueError):
    """A file that has more than it may."""


def read_limited(path: Path, most_bytes: int) -> bytes:
    """The content of a plain file.

    Raises:
        FileNotFoundError: there is none.
        IsADirectoryError: it is something else, as a folder or a pipe, which would be waited for.
        TooLargeError: it has more than `most_bytes`.
        OSError: it cannot be read.
    """
    if not path.is_file():
        raise IsADirectoryError(f"{path} is not a file") if path.exists() else FileNotFoundError(f"no {path}")
    with path.open("rb") as file:
        content = file.read(most_bytes + 1)
    if len(content) > most_bytes:
        raise TooLargeError(f"{path} has more than {most_bytes >> 20} MiB")
    return content


def read_in_folder(path: Path, most_bytes: int, missing: str) -> bytes:
    """A file of a calibration's folder. Raises CalibrationFolderError; `missing` says what to do when there is none."""
    try:
        return read_limited(path, most_bytes)
    except FileNotFoundError as error:
        raise CalibrationFolderError(f"there is no {path}: {missing}") from error
    except TooLargeError as error:
        raise CalibrationFolderError(str(error)) from error
    except OSError as error:
        raise CalibrationFolderError(f"{path} cannot be read: {error.strerror or error}") from error


def write_synced(path: Path, content: bytes, mode: int = 0o666) -> None:
    """Writes a new file and makes sure that its content is on the disk; its name is after `sync_folder`. `mode` says
    who may read and write it, as far as the process's umask lets it.

    Raises:
        OSError: it cannot be written, or there is one of that name.
    """
    with open(path, "xb", opener=partial(os.open, mode=mode)) as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())


def replace_synced(path: Path, content: bytes, mode: int = 0o666) -> None:
    """Writes a file; one of that name is replaced in one step. On return it is on the disk. `mode` as above.

    Raises:
        OSError: it cannot be written; what was there before is left alone.
    """
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        part.unlink(missing_ok=True)  # of a process of this number that was killed
        write_synced(part, content, mode)
        part.replace(path)
    except OSError as error:
        with suppress(OSError):
            part.unlink()
        # Of the same kind, by its number; the other file's name means nothing to anybody.
        raise OSError(error.errno, error.strerror, str(path)) from error
    sync_folder(path.parent)


def sync_folder(folder: Path) -> None:
    """Makes sure that names made or changed in `folder` survive a loss of power. Raises OSError."""
    if os.name == "nt":  # Windows syncs names by itself, and cannot open a folder
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
