"""Fault 19 for replaced files: the active calibration, the pictures of a calibration, and the tokens."""

from pathlib import Path

import pytest

from calibration.atomic_write import replace_synced
from service.security.auth.tokens import TOKENS_FILE, TokensError, add_token, read_tokens
from tests.service.faults.full_disk import full_disk

pytestmark = pytest.mark.fault(19)


def test_a_replaced_file_is_either_old_or_new(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file, disk = tmp_path / "picture.png", full_disk(monkeypatch)
    replace_synced(file, b"first")
    for write in (1, 2):
        disk.fill(write)
        with pytest.raises(OSError, match="No space left"):
            replace_synced(file, b"second")
        disk.clear()
        assert file.read_bytes() == (b"first", b"second")[write - 1]
        assert list(tmp_path.iterdir()) == [file]


def test_a_full_disk_leaves_the_tokens_unchanged(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    add_token(tmp_path, "ann", "viewer")
    disk = full_disk(monkeypatch)
    before = (tmp_path / TOKENS_FILE).read_bytes()
    disk.fill(1)
    with pytest.raises(TokensError, match="No space left"):
        add_token(tmp_path, "bob", "viewer")
    disk.clear()
    assert (tmp_path / TOKENS_FILE).read_bytes() == before
    add_token(tmp_path, "bob", "viewer")
    assert [token.name for token in read_tokens(tmp_path / TOKENS_FILE)] == ["ann", "bob"]
