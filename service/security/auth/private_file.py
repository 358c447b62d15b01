"""A JSON file in the data folder that only its owner may read: read when it has changed, replaced atomically."""

import json
import logging
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Generic, TypeVar

from pydantic import BaseModel, ValidationError

from calibration.atomic_write import TooLargeError, read_limited, replace_synced

log = logging.getLogger(__name__)

MAX_FILE_BYTES = 1 << 20

Document = TypeVar("Document", bound=BaseModel)


class TokensError(ValueError):
    """The tokens, or the sign-ins made with them, cannot be read or changed."""

    slug = "tokens"


class WatchedFile(Generic[Document]):
    """The current content of a file, which is read again when it has changed. Not safe to use from several threads."""

    def __init__(self, path: Path, kind: type[Document]) -> None:
        """Watch a file.

        Args:
            path: The file.
            kind: Model of its content. Without arguments it is the content of a file that does not exist.
        """
        self._path, self._kind = path, kind
        self._file_state: object = ()  # nothing is known yet, not even that there is no file
        """Times, size and inode of the file that was read last, None without a file, or the number of an error."""
        self._document = kind()
        self._unreadable = False

    @property
    def document(self) -> Document:
        """The content. If the file cannot be read, it is the content that was read before."""
        self._reload_if_changed()
        return self._document

    @property
    def unreadable(self) -> bool:
        """Whether the file cannot be read, or its content is invalid."""
        self._reload_if_changed()
        return self._unreadable

    def _reload_if_changed(self) -> None:
        try:
            now = self._path.stat()
            state: object = (now.st_mtime_ns, now.st_ctime_ns, now.st_size, now.st_ino)
        except FileNotFoundError:
            state = None
        except OSError as error:
            state = error.errno
        if state == self._file_state:
            return
        self._file_state = state
        try:
            self._document = read_document(self._path, self._kind)
            self._unreadable = False
        except TokensError as error:
            self._unreadable = True
            log.error("%s; what was read before stays valid until the file is repaired", error)


def read_document(path: Path, kind: type[Document]) -> Document:
    """Return the content of a file.

    Args:
        path: The file.
        kind: Model of its content. Without arguments it is the content of a file that does not exist.

    Raises:
        TokensError: The file cannot be read, or its content is invalid.
    """
    try:
        return kind.model_validate_json(read_limited(path, MAX_FILE_BYTES))
    except FileNotFoundError:
        return kind()
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(map(str, first["loc"]))
        raise TokensError(f"{path} is damaged: {where + ': ' if where else ''}{first['msg']}") from error
    except TooLargeError as error:
        raise TokensError(str(error)) from error
    except OSError as error:
        raise TokensError(f"{path} cannot be read: {error.strerror or error}") from error


def write_document(path: Path, document: BaseModel) -> None:
    """Replace a file. The caller holds the lock.

    Raises:
        TokensError: The content is too large to be read again.
        OSError: The file cannot be written.
    """
    content = (json.dumps(document.model_dump(mode="json"), indent=2) + "\n").encode()
    if len(content) > MAX_FILE_BYTES:
        raise TokensError(f"{path} would be larger than {MAX_FILE_BYTES >> 20} MiB: remove unused tokens first")
    replace_synced(path, content, mode=0o600)


@contextmanager
def lock_for_change(path: Path) -> Iterator[None]:
    """Lock the files of the folder of `path` against other writers. The folder is created if it does not exist.

    Raises:
        TokensError: The file cannot be written.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with _lock(path.parent):
            yield
    except OSError as error:
        raise TokensError(f"{path} cannot be written: {error.strerror or error}") from error


@contextmanager
def _lock(folder: Path) -> Iterator[None]:
    """Lock a folder itself; a running service always holds the lock file in it."""
    try:
        import fcntl
    except ImportError:  # not POSIX: there is no lock
        yield
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)
