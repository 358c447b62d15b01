"""Read files up to a size limit, and write files so that they survive a power failure."""

import os
from contextlib import suppress
from functools import partial
from pathlib import Path

from calibration.errors import CalibrationFolderError


class TooLargeError(ValueError):
    """A file exceeds its size limit."""


def read_limited(path: str | os.PathLike[str], max_bytes: int) -> bytes:
    """Return the content of a regular file.

    Args:
        path: The file.
        max_bytes: Maximum size of the file, bytes.

    Raises:
        FileNotFoundError: The file does not exist.
        IsADirectoryError: The path is not a regular file, for example a folder or a pipe.
        TooLargeError: The file is larger than `max_bytes`.
        OSError: The file cannot be read.
    """
    path = Path(path)
    if not path.is_file():
        if path.exists():
            raise IsADirectoryError(f"{path} is not a file")
        raise FileNotFoundError(f"no {path}")
    with path.open("rb") as file:
        content = file.read(max_bytes + 1)
    if len(content) > max_bytes:
        raise TooLargeError(f"{path} has more than {max_bytes >> 20} MiB")
    return content


def read_calibration_file(path: str | os.PathLike[str], max_bytes: int, remedy: str) -> bytes:
    """Return the content of a file in a calibration folder.

    Args:
        path: The file.
        max_bytes: Maximum size of the file, bytes.
        remedy: Advice in the error message if the file does not exist.

    Raises:
        CalibrationFolderError: The file is missing, too large or not readable.
    """
    path = Path(path)
    try:
        return read_limited(path, max_bytes)
    except FileNotFoundError as error:
        raise CalibrationFolderError(f"there is no {path}: {remedy}") from error
    except TooLargeError as error:
        raise CalibrationFolderError(str(error)) from error
    except OSError as error:
        raise CalibrationFolderError(f"{path} cannot be read: {error.strerror or error}") from error


def write_synced(path: str | os.PathLike[str], content: bytes, mode: int = 0o666) -> None:
    """Write a new file and sync its content to the disk.

    Call `sync_folder` afterwards to sync the name of the file too.

    Args:
        path: The file.
        content: Content of the file.
        mode: Permissions of the file, before the umask is applied.

    Raises:
        OSError: The file exists already, or cannot be written.
    """
    with open(path, "xb", opener=partial(os.open, mode=mode)) as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())


def replace_synced(path: str | os.PathLike[str], content: bytes, mode: int = 0o666) -> None:
    """Write or replace a file atomically, and sync its content and name to the disk.

    Args:
        path: The file.
        content: New content of the file.
        mode: Permissions of the file, before the umask is applied.

    Raises:
        OSError: The file cannot be written; an existing file is then unchanged. Also raised if the folder cannot be
            synced; the file is then already replaced.
    """
    path = Path(path)
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        part.unlink(missing_ok=True)  # A killed process with the same process id may have left it.
        write_synced(part, content, mode)
        part.replace(path)
    except OSError as error:
        with suppress(OSError):
            part.unlink()
        # Report the name of the final file instead of the temporary file. The errno keeps the subclass of OSError.
        raise OSError(error.errno, error.strerror, str(path)) from error
    sync_folder(path.parent)


def sync_folder(folder: str | os.PathLike[str]) -> None:
    """Sync the file names in a folder to the disk, so that they survive a power failure.

    Raises:
        OSError: The folder cannot be opened or synced.
    """
    if os.name == "nt":  # Windows cannot open a folder, and syncs the names itself.
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
