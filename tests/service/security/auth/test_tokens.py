"""Tokens: shown once, stored as hashes, valid at once and removed at once."""

import hmac
import json
import logging
import os
import re
import stat
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

from service.cli.main import main
from service.security.auth.tokens import (
    TOKENS_FILE,
    TokenFile,
    TokensError,
    add_token,
    hash_token,
    read_tokens,
    remove_token,
)


def test_only_the_hash_of_a_token_is_stored(tmp_path: Path) -> None:
    token = add_token(tmp_path / "new", "planner", "operator")
    assert re.fullmatch(r"pct_[A-Za-z0-9_-]{43}", token)  # 32 bytes
    file = tmp_path / "new" / TOKENS_FILE
    assert token not in file.read_text()
    assert token.removeprefix("pct_") not in file.read_text()
    assert stat.S_IMODE(file.stat().st_mode) == 0o600
    assert json.loads(file.read_text())["schema_version"] == 1
    (stored,) = read_tokens(file)
    assert (stored.name, stored.role, stored.sha256) == ("planner", "operator", hash_token(token))
    assert add_token(tmp_path / "new", "other", "viewer") != token


@pytest.mark.parametrize("name", ["", "1st", "a b", "../x", "a\n", "local", "service", "console", "ü", "a" * 65, "a:b"])
def test_an_invalid_name_is_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(TokensError, match="cannot be a token's name"):
        add_token(tmp_path, name, "viewer")
    assert not (tmp_path / TOKENS_FILE).exists()


def test_names_are_unique_and_concurrent_changes_are_kept(tmp_path: Path) -> None:
    with ThreadPoolExecutor(8) as pool:
        list(pool.map(lambda k: add_token(tmp_path, f"n{k}", "viewer"), range(16)))
    assert len(read_tokens(tmp_path / TOKENS_FILE)) == 16
    with pytest.raises(TokensError, match="already"):
        add_token(tmp_path, "n3", "viewer")


def test_every_stored_hash_is_compared_in_constant_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    tokens = [add_token(tmp_path, f"n{k}", "viewer") for k in range(5)]
    compared: list[Any] = []

    def spy(a: str, b: str) -> bool:
        compared.append((a, b))
        return original(a, b)

    original = hmac.compare_digest
    monkeypatch.setattr("service.security.auth.tokens.hmac.compare_digest", spy)
    file = TokenFile(tmp_path)
    for sent, name in ((tokens[0], "n0"), (tokens[4], "n4"), ("pct_none", None)):
        compared.clear()
        found = file.find(sent)
        assert (found.name if found else None) == name
        assert compared == [(hash_token(token), hash_token(sent)) for token in tokens]


def test_a_change_of_the_file_applies_at_once(tmp_path: Path) -> None:
    file = TokenFile(tmp_path)
    assert file.is_empty
    token = add_token(tmp_path, "a", "viewer")
    assert not file.is_empty
    assert file.find(token) is not None
    other = add_token(tmp_path, "b", "viewer")
    remove_token(tmp_path, "a")
    assert file.find(token) is None
    assert file.find(other) is not None
    remove_token(tmp_path, "b")
    assert file.is_empty
    with pytest.raises(TokensError, match="there is no token b; the existing tokens are: none"):
        remove_token(tmp_path, "b")


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"{",
        b"\xff\xfe",
        b"[]",
        b'{"schema_version": 2, "tokens": []}',
        b'{"schema_version": 1, "tokens": [{"name": "a"}]}',
        b"[" * 100_000,
        b" " * (2 << 20),
    ],
    ids=["empty", "cut", "binary", "list", "later", "short", "deep", "large"],
)
def test_a_damaged_file_adds_no_tokens_and_keeps_the_known_ones(
    tmp_path: Path, content: bytes, caplog: pytest.LogCaptureFixture
) -> None:
    token = add_token(tmp_path, "a", "viewer")
    file = TokenFile(tmp_path)
    assert file.find(token) is not None
    (tmp_path / TOKENS_FILE).write_bytes(content)
    with caplog.at_level(logging.ERROR):
        for _ in range(3):
            assert file.find(token) is not None
    assert len(caplog.records) == 1  # logged once, not at each request
    # A service that starts with this file knows no token, and does not take the file for an empty one.
    fresh = TokenFile(tmp_path)
    assert fresh.find(token) is None
    assert not fresh.is_empty
    with pytest.raises(TokensError):
        add_token(tmp_path, "b", "viewer")
    assert (tmp_path / TOKENS_FILE).read_bytes() == content
    (tmp_path / TOKENS_FILE).unlink()
    assert file.find(token) is None
    assert file.is_empty


@pytest.mark.skipif(os.geteuid() == 0, reason="root can read every file")
def test_an_unreadable_file_is_read_as_soon_as_it_is_readable(tmp_path: Path) -> None:
    token = add_token(tmp_path, "a", "viewer")
    (tmp_path / TOKENS_FILE).chmod(0)
    file = TokenFile(tmp_path)
    assert not file.is_empty
    assert file.find(token) is None
    (tmp_path / TOKENS_FILE).chmod(0o600)
    assert file.find(token) is not None


def test_tokens_are_managed_on_the_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    data_dir = ["--data-dir", str(tmp_path)]
    assert main(["token", "list", *data_dir]) == 0
    assert "every client on this machine may do everything" in capsys.readouterr().err
    assert main(["token", "add", "anna", "--role", "maintainer", *data_dir]) == 0
    output = capsys.readouterr()
    token = output.out.strip()
    assert token.startswith("pct_")
    assert token not in output.err
    stored = TokenFile(tmp_path).find(token)
    assert stored is not None
    assert stored.role == "maintainer"

    config = tmp_path / "cell.toml"
    config.write_text(f'data_dir = "{tmp_path}"\n')
    assert main(["token", "list", "--config", str(config)]) == 0
    listed = capsys.readouterr().out
    assert listed.split("\t")[:2] == ["anna", "maintainer"]
    assert token not in listed

    for wrong in (["add", "anna", "--role", "viewer"], ["add", "no good", "--role", "viewer"], ["remove", "bert"]):
        assert main(["token", *wrong, *data_dir]) == 1
        output = capsys.readouterr()
        assert output.err.startswith(f"pointchain token {wrong[0]}: ")
        assert output.out == ""
    assert main(["token", "remove", "anna", *data_dir]) == 0
    assert "last token" in capsys.readouterr().err
    assert TokenFile(tmp_path).is_empty
