"""Sign-in codes and their sessions: valid once and for a while, stored as hashes, and refused without their token."""

import json
import re
import stat
import threading
from concurrent.futures import ThreadPoolExecutor
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from service.security.auth import sessions
from service.security.auth.private_file import TokensError
from service.security.auth.sessions import (
    MAX_SESSIONS,
    SESSION_LIFETIME,
    SESSIONS_FILE,
    SessionFile,
    add_code,
    end_session,
    read_sessions,
    redeem_code,
    remove_outdated,
)
from service.security.auth.sign_in_codes import hash_code, normalise_code
from service.security.auth.tokens import TOKENS_FILE, add_token, hash_token, read_tokens, remove_token
from tests.service.faults.full_disk import full_disk

NOW = datetime(2026, 5, 1, 12, 0, tzinfo=UTC)
SECOND = timedelta(seconds=1)


@pytest.fixture
def data(tmp_path: Path) -> Path:
    """A data folder with the tokens ann and bob."""
    add_token(tmp_path, "ann", "operator")
    add_token(tmp_path, "bob", "viewer")
    return tmp_path


def new_session(data: Path, name: str = "ann") -> str:
    made = redeem_code(data, add_code(data, name, 10, NOW).code, NOW)
    assert made is not None
    return made.secret


def token_hash(data: Path, name: str) -> str:
    return next(token.sha256 for token in read_tokens(data / TOKENS_FILE) if token.name == name)


def test_only_hashes_of_codes_and_sessions_are_stored(data: Path) -> None:
    tokens = (data / TOKENS_FILE).read_bytes()
    made = add_code(data, "ann", 10, NOW)
    assert re.fullmatch(r"[0-9A-HJKMNP-TV-Z]{4}-[0-9A-HJKMNP-TV-Z]{4}", made.code)
    assert (made.token.name, made.token.role, made.expires) == ("ann", "operator", NOW + timedelta(minutes=10))
    file = data / SESSIONS_FILE
    assert stat.S_IMODE(file.stat().st_mode) == 0o600
    code = made.code.replace("-", "")
    (stored,) = read_sessions(file).codes
    assert (stored.scrypt, stored.token_sha256) == (hash_code(code), token_hash(data, "ann"))
    assert hash_token(code) not in file.read_text()  # a fast hash of a code could be reversed
    session = redeem_code(data, made.code, NOW)
    assert session is not None
    assert re.fullmatch(r"pcs_[A-Za-z0-9_-]{43}", session.secret)  # 32 bytes
    text = file.read_text()
    assert not [secret for secret in (made.code, code, session.secret, session.secret[4:]) if secret in text]
    assert stat.S_IMODE(file.stat().st_mode) == 0o600
    assert (data / TOKENS_FILE).read_bytes() == tokens, "a sign-in writes no token"


@pytest.mark.parametrize("typed", ["{}", " {}\n", "{lower}", "{bare}", "{spaced}", "{dashed}"])
def test_a_code_may_be_typed_in_lower_case_with_spaces_and_dashes(data: Path, typed: str) -> None:
    code = add_code(data, "ann", 10, NOW).code
    bare = code.replace("-", "")
    spaced, dashed = " ".join(bare.lower()), "\N{EN DASH}".join((bare[:2], bare[2:]))
    text = typed.format(code, lower=code.lower(), bare=bare, spaced=spaced, dashed=dashed)
    assert redeem_code(data, text, NOW) is not None


@pytest.mark.parametrize(
    ("typed", "code"),
    [
        ("oOiIlL23", "00111123"),
        ("ABCD-EFGH", "ABCDEFGH"),
        ("ABCD-EFG", None),
        ("ABCD-EFGHJ", None),
        ("ABCD-EFGU", None),
        ("ABCD_EFGH", None),
        ("ÀBCD-EFGH", None),
        ("ABCD-EFG\N{FULLWIDTH DIGIT ONE}", None),
        ("", None),
        ("\0" * 8, None),
    ],
)
def test_look_alikes_are_read_as_digits_and_other_characters_are_refused(typed: str, code: str | None) -> None:
    assert normalise_code(typed) == code


def test_a_code_is_valid_once_and_until_it_expires(data: Path) -> None:
    used = add_code(data, "ann", 10, NOW).code
    assert redeem_code(data, used, NOW + timedelta(minutes=10) - SECOND) is not None
    assert redeem_code(data, used, NOW + timedelta(minutes=10) - SECOND) is None
    expired = add_code(data, "ann", 1, NOW).code
    assert redeem_code(data, expired, NOW + timedelta(minutes=1)) is None
    # the clock was set back after the code was made
    future = add_code(data, "ann", 10, NOW).code
    assert redeem_code(data, future, NOW - timedelta(days=1)) is None


def test_a_wrong_code_changes_nothing(data: Path) -> None:
    code = add_code(data, "ann", 10, NOW).code
    before = (data / SESSIONS_FILE).read_bytes()
    wrong = code[:-1] + ("0" if code[-1] != "0" else "1")
    assert redeem_code(data, wrong, NOW) is None
    assert redeem_code(data, "no code", NOW) is None
    assert (data / SESSIONS_FILE).read_bytes() == before
    assert redeem_code(data, code, NOW) is not None


def test_a_new_code_replaces_that_of_the_same_token_only(data: Path) -> None:
    first, other, second = (add_code(data, name, 10, NOW).code for name in ("ann", "bob", "ann"))
    assert redeem_code(data, first, NOW) is None
    for code, name in ((other, "bob"), (second, "ann")):
        made = redeem_code(data, code, NOW)
        assert made is not None
        assert made.token.name == name


def test_of_simultaneous_uses_exactly_one_succeeds(data: Path) -> None:
    code = add_code(data, "ann", 10, NOW).code
    begin = threading.Barrier(8)

    def use(_: int) -> bool:
        begin.wait()
        return redeem_code(data, code, NOW) is not None

    with ThreadPoolExecutor(8) as pool:
        assert sum(pool.map(use, range(8))) == 1
    assert len(read_sessions(data / SESSIONS_FILE).sessions) == 1


def test_a_session_has_the_token_of_its_code_until_it_expires(data: Path) -> None:
    file, secret = SessionFile(data), new_session(data, "bob")
    assert file.find_token_hash(secret, NOW) == token_hash(data, "bob")
    assert file.find_token_hash(secret + "x", NOW) is None
    assert file.find_token_hash(secret, NOW + SESSION_LIFETIME - SECOND) is not None
    assert file.find_token_hash(secret, NOW + SESSION_LIFETIME) is None


def test_codes_and_sessions_go_with_their_token(data: Path) -> None:
    kept, secret = new_session(data, "bob"), new_session(data)
    code = add_code(data, "ann", 10, NOW).code
    remove_token(data, "ann")
    add_token(data, "ann", "maintainer")  # the same name is another token
    assert redeem_code(data, code, NOW) is None
    assert SessionFile(data).find_token_hash(secret, NOW) != token_hash(data, "ann")
    remove_outdated(data, NOW)
    document = read_sessions(data / SESSIONS_FILE)
    assert [one.token_sha256 for one in document.sessions] == [token_hash(data, "bob")]
    assert document.codes == ()
    assert SessionFile(data).find_token_hash(kept, NOW) is not None


def test_a_session_can_be_ended(data: Path) -> None:
    file = SessionFile(data)
    kept, ended = new_session(data), new_session(data)
    assert file.find_token_hash(ended, NOW) is not None
    end_session(data, ended, NOW)
    assert file.find_token_hash(ended, NOW) is None
    assert file.find_token_hash(kept, NOW) is not None


def test_a_token_has_a_limited_number_of_sessions(data: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sessions, "MAX_SESSIONS", 2)
    assert MAX_SESSIONS > 2
    other = new_session(data, "bob")
    first, second, third = (new_session(data) for _ in range(3))
    file = SessionFile(data)
    assert file.find_token_hash(first, NOW) is None
    for secret in (second, third, other):
        assert file.find_token_hash(secret, NOW) is not None


def test_a_code_needs_an_existing_token(data: Path) -> None:
    with pytest.raises(TokensError, match="there is no token carl; the existing tokens are: ann, bob"):
        add_code(data, "carl", 10, NOW)
    assert not (data / SESSIONS_FILE).exists()


@pytest.mark.parametrize(
    "content",
    [b"", b"{", b"\xff", b"[]", b'{"schema_version": 2}', b'{"sessions": [{}]}', b'{"more": 1}', b" " * (2 << 20)],
    ids=["empty", "cut", "binary", "list", "later", "short", "unknown", "large"],
)
def test_a_damaged_file_is_kept_and_the_known_sessions_stay_valid(data: Path, content: bytes) -> None:
    file, secret = SessionFile(data), new_session(data)
    code = add_code(data, "ann", 10, NOW).code
    assert file.find_token_hash(secret, NOW) is not None
    (data / SESSIONS_FILE).write_bytes(content)
    assert file.find_token_hash(secret, NOW) is not None
    assert SessionFile(data).find_token_hash(secret, NOW) is None  # a service that starts with this file
    for change in (
        lambda: add_code(data, "ann", 10, NOW),
        lambda: redeem_code(data, code, NOW),
        lambda: end_session(data, secret, NOW),
        lambda: remove_outdated(data, NOW),
    ):
        with pytest.raises(TokensError):
            change()
    assert (data / SESSIONS_FILE).read_bytes() == content


def test_a_file_that_could_not_be_read_again_is_not_written(data: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for _ in range(3):
        new_session(data)  # the file is larger than that of the tokens
    code = add_code(data, "ann", 10, NOW).code
    size = (data / SESSIONS_FILE).stat().st_size
    monkeypatch.setattr("service.security.auth.private_file.MAX_FILE_BYTES", size + 10)
    with pytest.raises(TokensError, match="remove unused tokens first"):
        redeem_code(data, code, NOW)
    monkeypatch.undo()
    assert redeem_code(data, code, NOW) is not None


def test_a_full_disk_does_not_use_a_code_up(data: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    code = add_code(data, "ann", 10, NOW).code
    disk = full_disk(monkeypatch)
    disk.fill(1)
    with pytest.raises(TokensError, match="No space left"):
        redeem_code(data, code, NOW)
    disk.clear()
    assert redeem_code(data, code, NOW) is not None


def test_the_file_has_a_version(data: Path) -> None:
    add_code(data, "ann", 10, NOW)
    assert json.loads((data / SESSIONS_FILE).read_text())["schema_version"] == 1
