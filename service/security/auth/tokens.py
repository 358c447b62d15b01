"""The tokens of the clients, in DATA_DIR/tokens.json.

They are in a file and not in the database, so that a stop works while the database is locked, and a token can be
removed at any time. The file holds only the SHA-256 of each token. A slow hash, as for passwords, would add nothing: a
token is 32 random bytes, which cannot be guessed.
"""

import hashlib
import hmac
import re
import secrets
from datetime import datetime
from pathlib import Path
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

from service.clock import utc_now
from service.security.auth.caller import LOCAL, Role
from service.security.auth.private_file import (
    TokensError,
    WatchedFile,
    lock_for_change,
    read_document,
    write_document,
)

TOKENS_FILE = "tokens.json"
PREFIX = "pct_"
"""Start of every token, by which people and secret scanners recognise it."""
NAME_PATTERN = r"^[A-Za-z][A-Za-z0-9._-]{0,63}$"
RESERVED_NAMES = (LOCAL.name, "service", "console")
"""Names with another meaning in the audit log."""


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
        self._file = WatchedFile(data_dir / TOKENS_FILE, _TokensDocument)

    @property
    def is_empty(self) -> bool:
        """Whether there are no tokens. False if the file cannot be read."""
        return not self._file.document.tokens and not self._file.unreadable

    def find(self, token: str) -> Token | None:
        """Return the stored part of a token, or None if the token is unknown."""
        return self.find_hash(hash_token(token))

    def find_hash(self, sha256: str) -> Token | None:
        """Return the stored part of the token with this SHA-256, or None if there is no such token."""
        found = None
        # All tokens are compared, each in constant time, so that the duration reveals nothing about them.
        for known in self._file.document.tokens:
            if hmac.compare_digest(known.sha256, sha256):
                found = known
        return found


def hash_token(token: str) -> str:
    """Return the SHA-256 of a token, as in the file."""
    return hashlib.sha256(token.encode()).hexdigest()


def read_tokens(path: Path) -> tuple[Token, ...]:
    """Return the tokens in a file; without a file there are none.

    Raises:
        TokensError: The file cannot be read, or its content is invalid.
    """
    return read_document(path, _TokensDocument).tokens


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
    path = data_dir / TOKENS_FILE
    with lock_for_change(path):
        tokens = read_tokens(path)
        if any(known.name == name for known in tokens):
            raise TokensError(f"there is already a token {name}: remove it first, or choose another name")
        created = utc_now().replace(microsecond=0)
        added = Token(name=name, role=role, sha256=hash_token(token), created=created)
        write_document(path, _TokensDocument(tokens=(*tokens, added)))
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
    path = data_dir / TOKENS_FILE
    with lock_for_change(path):
        tokens = read_tokens(path)
        find_token(tokens, name)
        remaining = tuple(token for token in tokens if token.name != name)
        write_document(path, _TokensDocument(tokens=remaining))
    return remaining


def find_token(tokens: tuple[Token, ...], name: str) -> Token:
    """Return the token of a name.

    Raises:
        TokensError: There is no token of this name.
    """
    found = next((token for token in tokens if token.name == name), None)
    if found is None:
        known = ", ".join(token.name for token in tokens) or "none"
        raise TokensError(f"there is no token {name}; the existing tokens are: {known}")
    return found
