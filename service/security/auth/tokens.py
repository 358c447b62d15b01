"""The tokens of the clients, in DATA_DIR/tokens.json.

They are in a file and not in the database, so that a stop works while the database is locked, and a token can be
removed at any time. The file holds only the SHA-256 of each token. A slow hash, as for passwords, would add nothing: a
token is 32 random bytes, which cannot be guessed.
"""

import hashlib
import hmac
import json
import logging
import os
import re
import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from calibration.atomic_write import TooLargeError, read_limited, replace_synced
from service.security.auth.caller import LOCAL, Role

log = logging.getLogger(__name__)

TOKENS_FILE = "tokens.json"
PREFIX = "pct_"
"""Start of every token, by which people and secret scanners recognise it."""
MAX_FILE_BYTES = 1 << 20
NAME_PATTERN = r"^[A-Za-z][A-Za-z0-9._-]{0,63}$"
RESERVED_NAMES = (LOCAL.name, "service", "console")
"""Names with another meaning in the audit log."""


class TokensError(ValueError):
    """The tokens cannot be read or changed."""

    slug = "tokens"


class Token(BaseModel):
    """The stored part of a token."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    name: Annotated[str, Field(pattern=NAME_PATTERN)]
    role: Role
    sha256: Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
    created: datetime


class _TokensDocument(BaseModel):
    """The content of the file."""

    model_config = ConfigDict(extra="forbid")

    schema_version: Literal[1] = 1
    tokens: tuple[Token, ...] = ()

    @model_validator(mode="after")
    def _check_unique_names(self) -> "_TokensDocument":
        if len({token.name for token in self.tokens}) != len(self.tokens):
            raise ValueError("two tokens have the same name")
        return self


class TokenFile:
    """The current tokens. The file is read again when it has changed. Not safe to use from several threads."""

    def __init__(self, data_dir: Path) -> None:
        self._path = data_dir / TOKENS_FILE
        self._file_state: object = ()  # nothing is known yet, not even that there is no file
        """Times, size and inode of the file that was read last, None without a file, or the number of an error."""
        self._tokens: tuple[Token, ...] = ()
        self._unreadable = False

    @property
    def is_empty(self) -> bool:
        """Whether there are no tokens. False if the file cannot be read."""
        self._reload_if_changed()
        return not self._tokens and not self._unreadable

    def find(self, token: str) -> Token | None:
        """Return the stored part of a token, or None if the token is unknown."""
        self._reload_if_changed()
        digest = hash_token(token)
        found = None
        # All tokens are compared, each in constant time, so that the duration reveals nothing about them.
        for known in self._tokens:
            if hmac.compare_digest(known.sha256, digest):
                found = known
        return found

    def _reload_if_changed(self) -> None:
        """Read the file if it has changed. If it cannot be read, keep the tokens that were read before."""
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
            self._tokens = read_tokens(self._path)
            self._unreadable = False
        except TokensError as error:
            self._unreadable = True
            log.error("%s; the tokens that were read before stay valid until the file is repaired", error)


def hash_token(token: str) -> str:
    """Return the SHA-256 of a token, as in the file."""
    return hashlib.sha256(token.encode()).hexdigest()


def read_tokens(path: Path) -> tuple[Token, ...]:
    """Return the tokens in a file; without a file there are none.

    Raises:
        TokensError: The file cannot be read, or its content is invalid.
    """
    try:
        content = read_limited(path, MAX_FILE_BYTES)
        return _TokensDocument.model_validate_json(content).tokens
    except FileNotFoundError:
        return ()
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(map(str, first["loc"]))
        raise TokensError(f"{path} is damaged: {where + ': ' if where else ''}{first['msg']}") from error
    except TooLargeError as error:
        raise TokensError(str(error)) from error
    except OSError as error:
        raise TokensError(f"{path} cannot be read: {error.strerror or error}") from error


def add_token(data_dir: Path, name: str, role: Role) -> str:
    """Make a token, which is valid at once.

    Args:
        data_dir: The data folder.
        name: Name of the person or program, for the audit log.
        role: Role of the token.

    Returns:
        The token. It is not stored anywhere.

    Raises:
        TokensError: The name is invalid or in use, or the file cannot be read or written.
    """
    if not re.fullmatch(NAME_PATTERN, name) or "\n" in name:
        raise TokensError(
            f"{name!r} cannot be a token's name: use a letter, then up to 63 letters, digits, dots, underscores or "
            "hyphens"
        )
    if name in RESERVED_NAMES:
        raise TokensError(f"{name!r} cannot be a token's name: the audit log uses it; choose another name")
    token = PREFIX + secrets.token_urlsafe(32)
    with _lock_for_change(data_dir) as path:
        tokens = read_tokens(path)
        if any(known.name == name for known in tokens):
            raise TokensError(f"there is already a token {name}: remove it first, or choose another name")
        created = datetime.now(UTC).replace(microsecond=0)
        _write(path, (*tokens, Token(name=name, role=role, sha256=hash_token(token), created=created)))
    return token


def remove_token(data_dir: Path, name: str) -> tuple[Token, ...]:
    """Remove a token. Requests with it are refused from now on.

    Args:
        data_dir: The data folder.
        name: Name of the token.

    Returns:
        The remaining tokens.

    Raises:
        TokensError: There is no token of this name, or the file cannot be read or written.
    """
    with _lock_for_change(data_dir) as path:
        tokens = read_tokens(path)
        remaining = tuple(token for token in tokens if token.name != name)
        if remaining == tokens:
            known = ", ".join(token.name for token in tokens) or "none"
            raise TokensError(f"there is no token {name}; the existing tokens are: {known}")
        _write(path, remaining)
    return remaining


@contextmanager
def _lock_for_change(data_dir: Path) -> Iterator[Path]:
    """Lock the file against other writers and yield its path. The folder is created if it does not exist."""
    try:
        data_dir.mkdir(parents=True, exist_ok=True)
        with _lock(data_dir):
            yield data_dir / TOKENS_FILE
    except OSError as error:
        raise TokensError(f"{data_dir / TOKENS_FILE} cannot be written: {error.strerror or error}") from error


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


def _write(path: Path, tokens: tuple[Token, ...]) -> None:
    document = _TokensDocument(tokens=tokens).model_dump(mode="json")
    replace_synced(path, (json.dumps(document, indent=2) + "\n").encode(), mode=0o600)
