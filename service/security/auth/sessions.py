"""Sign-in codes and the sessions made with them, in DATA_DIR/sessions.json.

A code signs one browser in as the holder of a token, without the token itself, which is not stored anywhere. The
browser gets a session of its own: 32 random bytes. Code and session refer to their token by its SHA-256, and have its
name and its role. When the token is removed, they are refused at once, even if they are still in this file.
"""

import hmac
import secrets
from dataclasses import dataclass
from datetime import datetime, timedelta
from pathlib import Path
from typing import Annotated, Literal

from pydantic import AwareDatetime, BaseModel, ConfigDict, Field

from service.security.auth.private_file import WatchedFile, lock_for_change, read_document, write_document
from service.security.auth.sign_in_codes import MAX_MINUTES, format_code, hash_code, make_code, normalise_code
from service.security.auth.tokens import TOKENS_FILE, Token, find_token, hash_token, read_tokens

SESSIONS_FILE = "sessions.json"
SESSION_PREFIX = "pcs_"
"""Start of every session's secret."""
SESSION_LIFETIME = timedelta(days=180)
MAX_SESSIONS = 100
"""Maximum number of sessions of one token. One more ends the oldest."""

_Hash = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]


class StoredCode(BaseModel):
    """The stored part of a code that was not used."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    scrypt: _Hash
    token_sha256: _Hash
    expires: AwareDatetime


class Session(BaseModel):
    """The stored part of a session."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    sha256: _Hash
    token_sha256: _Hash
    created: AwareDatetime
    expires: AwareDatetime


class SessionsDocument(BaseModel):
    """The content of the file."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    schema_version: Literal[1] = 1
    codes: tuple[StoredCode, ...] = ()
    sessions: tuple[Session, ...] = ()


@dataclass(frozen=True)
class NewCode:
    """A code that was just made."""

    code: str
    """The code, as XXXX-XXXX. It is not stored anywhere."""
    token: Token
    """The token as whose holder the code signs in."""
    expires: datetime


@dataclass(frozen=True)
class NewSession:
    """A session that was just made."""

    secret: str
    """The secret, for the cookie. It is not stored anywhere."""
    token: Token


class SessionFile:
    """The current sessions. The file is read again when it has changed. Not safe to use from several threads."""

    def __init__(self, data_dir: Path) -> None:
        self._file = WatchedFile(data_dir / SESSIONS_FILE, SessionsDocument)

    def find_token_hash(self, secret: str, now: datetime) -> str | None:
        """Return the SHA-256 of the token of a session, or None if the session is unknown or has expired.

        Args:
            secret: Secret of the session.
            now: Current time.
        """
        digest = hash_token(secret)
        found = None
        for known in self._file.document.sessions:  # all of them, as those of the tokens
            if hmac.compare_digest(known.sha256, digest):
                found = known
        return found.token_sha256 if found is not None and now < found.expires else None


def read_sessions(path: Path) -> SessionsDocument:
    """Return the content of a file of sessions; without a file there are none.

    Raises:
        TokensError: The file cannot be read, or its content is invalid.
    """
    return read_document(path, SessionsDocument)


def add_code(data_dir: Path, name: str, minutes: int, now: datetime) -> NewCode:
    """Make a code for the holder of a token. It replaces an earlier code of this token.

    Args:
        data_dir: The data folder.
        name: Name of the token.
        minutes: Lifetime of the code, 1 to `MAX_MINUTES`.
        now: Current time.

    Raises:
        TokensError: There is no token of this name, or a file cannot be read or written.
    """
    code = make_code()
    expires = now.replace(microsecond=0) + timedelta(minutes=minutes)
    path = data_dir / SESSIONS_FILE
    with lock_for_change(path):
        tokens = read_tokens(data_dir / TOKENS_FILE)
        token = find_token(tokens, name)
        document = _current(path, tokens, now)
        stored = StoredCode(scrypt=hash_code(code), token_sha256=token.sha256, expires=expires)
        others = tuple(one for one in document.codes if one.token_sha256 != token.sha256)
        write_document(path, document.model_copy(update={"codes": (*others, stored)}))
    return NewCode(format_code(code), token, expires)


def redeem_code(data_dir: Path, typed: str, now: datetime) -> NewSession | None:
    """Use a code up and make a session. The same code cannot be used twice, even at the same time.

    Args:
        data_dir: The data folder.
        typed: The code as a person typed it.
        now: Current time.

    Returns:
        The session, or None if the code is wrong, was used, or has expired.

    Raises:
        TokensError: A file cannot be read or written. The code can then be used again.
    """
    normalised = normalise_code(typed)
    if normalised is None:
        return None
    digest = hash_code(normalised)
    path = data_dir / SESSIONS_FILE
    with lock_for_change(path):
        tokens = read_tokens(data_dir / TOKENS_FILE)
        document = _current(path, tokens, now)
        code = next((one for one in document.codes if hmac.compare_digest(one.scrypt, digest)), None)
        if code is None:
            return None
        token = next(one for one in tokens if one.sha256 == code.token_sha256)
        secret = SESSION_PREFIX + secrets.token_urlsafe(32)
        created = now.replace(microsecond=0)
        session = Session(
            sha256=hash_token(secret), token_sha256=token.sha256, created=created, expires=created + SESSION_LIFETIME
        )
        own = [one for one in document.sessions if one.token_sha256 == token.sha256]
        ended = own[: max(0, len(own) + 1 - MAX_SESSIONS)]
        kept = (one for one in document.sessions if one not in ended)
        codes = tuple(one for one in document.codes if one is not code)
        write_document(path, SessionsDocument(codes=codes, sessions=(*kept, session)))
    return NewSession(secret, token)


def end_session(data_dir: Path, secret: str, now: datetime) -> None:
    """Remove a session. Requests with it are refused from now on.

    Raises:
        TokensError: A file cannot be read or written.
    """
    path = data_dir / SESSIONS_FILE
    with lock_for_change(path):
        document = _current(path, read_tokens(data_dir / TOKENS_FILE), now)
        kept = tuple(one for one in document.sessions if one.sha256 != hash_token(secret))
        write_document(path, document.model_copy(update={"sessions": kept}))


def remove_outdated(data_dir: Path, now: datetime) -> None:
    """Remove the codes and sessions that have expired or whose token was removed.

    Raises:
        TokensError: A file cannot be read or written.
    """
    path = data_dir / SESSIONS_FILE
    if not path.exists():
        return
    with lock_for_change(path):
        write_document(path, _current(path, read_tokens(data_dir / TOKENS_FILE), now))


def _current(path: Path, tokens: tuple[Token, ...], now: datetime) -> SessionsDocument:
    """Return the content of the file without what has expired or whose token was removed."""
    document = read_sessions(path)
    known = {token.sha256 for token in tokens}
    # A code that seems to expire later than any can was made before the wall clock was set back.
    latest = now + timedelta(minutes=MAX_MINUTES)
    codes = tuple(one for one in document.codes if one.token_sha256 in known and now < one.expires <= latest)
    sessions = tuple(one for one in document.sessions if one.token_sha256 in known and now < one.expires)
    return SessionsDocument(codes=codes, sessions=sessions)
