"""Tokens: who may speak to the service, in DATA_DIR/tokens.json.

A file and not the database, so that a stop works while the database is locked, and a token can be taken away at any
moment. It holds the tokens' SHA-256 alone. A slow hash, as passwords need, would add nothing: a token is 32 random
bytes, which nobody tries out.
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

FILE = "tokens.json"
PREFIX = "pct_"
"""By which people, and programs that look for secrets, know a token when they see one."""
LARGEST_BYTES = 1 << 20
NAME = r"^[A-Za-z][A-Za-z0-9._-]{0,63}$"
RESERVED = (LOCAL.name, "service", "console")
"""Names that the audit log has for others."""


class TokensError(ValueError):
    """Tokens that cannot be used, or a change of them that cannot be made."""

    slug = "tokens"


class Token(BaseModel):
    """What is kept of a token."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    name: Annotated[str, Field(pattern=NAME)]
    role: Role
    sha256: Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
    created: datetime


class _Form(BaseModel):
    """The file."""

    model_config = ConfigDict(extra="forbid")

    schema_version: Literal[1] = 1
    tokens: tuple[Token, ...] = ()

    @model_validator(mode="after")
    def _one_of_a_name(self) -> "_Form":
        if len({token.name for token in self.tokens}) != len(self.tokens):
            raise ValueError("two tokens have the same name")
        return self


class TokenFile:
    """The tokens as they are now: the file is read again when it has changed. Not safe to use from several threads."""

    def __init__(self, data_dir: Path) -> None:
        self._path = data_dir / FILE
        self._seen: object = ()  # nothing yet: not even that there is no file
        self._tokens: tuple[Token, ...] = ()
        self._broken = False

    @property
    def none(self) -> bool:
        """There is no token at all; not so when the file cannot be read."""
        self._look()
        return not self._tokens and not self._broken

    def find(self, token: str) -> Token | None:
        """What is kept of this token; None: it is none."""
        self._look()
        digest = hash_of(token)
        found = None
        # To the end, and each compared in constant time: how long it takes tells nothing of any of them.
        for known in self._tokens:
            if hmac.compare_digest(known.sha256, digest):
                found = known
        return found

    def _look(self) -> None:
        """Reads the file if it is not as it was seen last. One that cannot be used leaves the tokens as they were."""
        try:
            now = self._path.stat()
            seen: object = (now.st_mtime_ns, now.st_ctime_ns, now.st_size, now.st_ino)
        except FileNotFoundError:
            seen = None
        except OSError as error:
            seen = error.errno
        if seen == self._seen:
            return
        self._seen = seen
        try:
            self._tokens = read_tokens(self._path)
            self._broken = False
        except TokensError as error:
            self._broken = True
            log.error("%s; until it is mended, those tokens are good that were so before", error)


def hash_of(token: str) -> str:
    """What is kept of a token's text."""
    return hashlib.sha256(token.encode()).hexdigest()


def read_tokens(path: Path) -> tuple[Token, ...]:
    """The tokens in a file; none when there is no file.

    Raises:
        TokensError: it cannot be read, or is not what it should be.
    """
    try:
        content = read_limited(path, LARGEST_BYTES)
        return _Form.model_validate_json(content).tokens
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
    """Makes a token, good at once; its text, which is kept nowhere.

    Raises:
        TokensError: the name cannot be or is taken, or the file cannot be read or written.
    """
    if not re.fullmatch(NAME, name) or "\n" in name:
        raise TokensError(f"{name!r} cannot be a token's name: a letter, then up to 63 letters, digits, . _ or -")
    if name in RESERVED:
        raise TokensError(f"{name!r} cannot be a token's name: the audit log means others by it")
    token = PREFIX + secrets.token_urlsafe(32)
    with _changing(data_dir) as path:
        tokens = read_tokens(path)
        if any(known.name == name for known in tokens):
            raise TokensError(f"there is a token {name} already: remove it first, or take another name")
        created = datetime.now(UTC).replace(microsecond=0)
        _write(path, (*tokens, Token(name=name, role=role, sha256=hash_of(token), created=created)))
    return token


def remove_token(data_dir: Path, name: str) -> tuple[Token, ...]:
    """Takes a token away: it is refused from now on. Those that are left.

    Raises:
        TokensError: there is none of this name, or the file cannot be read or written.
    """
    with _changing(data_dir) as path:
        tokens = read_tokens(path)
        left = tuple(token for token in tokens if token.name != name)
        if left == tokens:
            known = ", ".join(token.name for token in tokens) or "none at all"
            raise TokensError(f"there is no token {name}; there are: {known}")
        _write(path, left)
    return left


@contextmanager
def _changing(data_dir: Path) -> Iterator[Path]:
    """The file's path, for as long as nobody else changes it. Makes the folder if need be."""
    try:
        data_dir.mkdir(parents=True, exist_ok=True)
        with _locked(data_dir):
            yield data_dir / FILE
    except OSError as error:
        raise TokensError(f"{data_dir / FILE} cannot be written: {error.strerror or error}") from error


@contextmanager
def _locked(folder: Path) -> Iterator[None]:
    """Not by the folder's own lock file: the service holds that one all the time."""
    try:
        import fcntl
    except ImportError:  # Not POSIX: it goes without a lock.
        yield
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)


def _write(path: Path, tokens: tuple[Token, ...]) -> None:
    document = _Form(tokens=tokens).model_dump(mode="json")
    replace_synced(path, (json.dumps(document, indent=2) + "\n").encode(), mode=0o600)
