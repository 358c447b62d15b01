"""Tokens: made once, kept as hashes, good and gone at once."""

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
from service.security.auth.tokens import FILE, TokenFile, TokensError, add_token, hash_of, read_tokens, remove_token


def test_a_token_is_known_by_its_hash_alone(tmp_path: Path) -> None:
    token = add_token(tmp_path / "new", "planner", "operator")
    assert re.fullmatch(r"pct_[A-Za-z0-9_-]{43}", token)  # 32 bytes
    file = tmp_path / "new" / FILE
    assert token not in file.read_text()
    assert token.removeprefix("pct_") not in file.read_text()
    assert stat.S_IMODE(file.stat().st_mode) == 0o600
    assert json.loads(file.read_text())["schema_version"] == 1
    (kept,) = read_tokens(file)
    assert (kept.name, kept.role, kept.sha256) == ("planner", "operator", hash_of(token))
    assert add_token(tmp_path / "new", "other", "viewer") != token


@pytest.mark.parametrize("name", ["", "1st", "a b", "../x", "a\n", "local", "service", "console", "ü", "a" * 65, "a:b"])
def test_a_name_that_cannot_be_is_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(TokensError, match="cannot be a token's name"):
        add_token(tmp_path, name, "viewer")
    assert not (tmp_path / FILE).exists()


def test_a_name_is_taken_once_and_no_change_of_many_at_a_time_is_lost(tmp_path: Path) -> None:
    with ThreadPoolExecutor(8) as pool:
        list(pool.map(lambda k: add_token(tmp_path, f"n{k}", "viewer"), range(16)))
    assert len(read_tokens(tmp_path / FILE)) == 16
    with pytest.raises(TokensError, match="already"):
        add_token(tmp_path, "n3", "viewer")


def test_each_kept_hash_is_compared_in_constant_time_to_the_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    tokens = [add_token(tmp_path, f"n{k}", "viewer") for k in range(5)]
    compared: list[Any] = []

    def spy(a: str, b: str) -> bool:
        compared.append((a, b))
        return genuine(a, b)

    genuine = hmac.compare_digest
    monkeypatch.setattr("service.security.auth.tokens.hmac.compare_digest", spy)
    file = TokenFile(tmp_path)
    for asked, name in ((tokens[0], "n0"), (tokens[4], "n4"), ("pct_none", None)):
        compared.clear()
        found = file.find(asked)
        assert (found.name if found else None) == name
        assert compared == [(hash_of(token), hash_of(asked)) for token in tokens]


def test_a_change_is_seen_at_once(tmp_path: Path) -> None:
    file = TokenFile(tmp_path)
    assert file.none
    token = add_token(tmp_path, "a", "viewer")
    assert not file.none
    assert file.find(token) is not None
    other = add_token(tmp_path, "b", "viewer")
    remove_token(tmp_path, "a")
    assert file.find(token) is None
    assert file.find(other) is not None
    remove_token(tmp_path, "b")
    assert file.none
    with pytest.raises(TokensError, match="there is no token b; there are: none at all"):
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
def test_a_damaged_file_lets_nobody_new_in_and_those_known_stay(
    tmp_path: Path, content: bytes, caplog: pytest.LogCaptureFixture
) -> None:
    token = add_token(tmp_path, "a", "viewer")
    file = TokenFile(tmp_path)
    assert file.find(token) is not None
    (tmp_path / FILE).write_bytes(content)
    with caplog.at_level(logging.ERROR):
        for _ in range(3):
            assert file.find(token) is not None
    assert len(caplog.records) == 1  # told once, not at each request
    # One that begins with it knows nobody, and does not take that for "there is no token".
    fresh = TokenFile(tmp_path)
    assert fresh.find(token) is None
    assert not fresh.none
    with pytest.raises(TokensError):
        add_token(tmp_path, "b", "viewer")
    assert (tmp_path / FILE).read_bytes() == content
    (tmp_path / FILE).unlink()
    assert file.find(token) is None
    assert file.none


@pytest.mark.skipif(os.geteuid() == 0, reason="root reads everything")
def test_a_file_that_cannot_be_read_is_read_once_it_can(tmp_path: Path) -> None:
    token = add_token(tmp_path, "a", "viewer")
    (tmp_path / FILE).chmod(0)
    file = TokenFile(tmp_path)
    assert not file.none
    assert file.find(token) is None
    (tmp_path / FILE).chmod(0o600)
    assert file.find(token) is not None


def test_on_the_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    place = ["--data-dir", str(tmp_path)]
    assert main(["token", "list", *place]) == 0
    assert "everybody on this machine" in capsys.readouterr().err
    assert main(["token", "add", "anna", "--role", "maintainer", *place]) == 0
    told = capsys.readouterr()
    token = told.out.strip()
    assert token.startswith("pct_")
    assert token not in told.err
    known = TokenFile(tmp_path).find(token)
    assert known is not None
    assert known.role == "maintainer"

    config = tmp_path / "cell.toml"
    config.write_text(f'data_dir = "{tmp_path}"\n')
    assert main(["token", "list", "--config", str(config)]) == 0
    listed = capsys.readouterr().out
    assert listed.split("\t")[:2] == ["anna", "maintainer"]
    assert token not in listed

    for wrong in (["add", "anna", "--role", "viewer"], ["add", "no good", "--role", "viewer"], ["remove", "bert"]):
        assert main(["token", *wrong, *place]) == 1
        told = capsys.readouterr()
        assert told.err.startswith(f"pointchain token {wrong[0]}: ")
        assert told.out == ""
    assert main(["token", "remove", "anna", *place]) == 0
    assert "last token" in capsys.readouterr().err
    assert TokenFile(tmp_path).none
