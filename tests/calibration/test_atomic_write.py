"""Atomic writes: a file is replaced as a whole, and errors name the final file."""

from pathlib import Path

import pytest

from calibration.atomic_write import replace_synced


def test_a_file_is_replaced_as_a_whole(tmp_path: Path) -> None:
    for content in (b"first, and longer", b"second"):
        replace_synced(tmp_path / "a.json", content)
        assert (tmp_path / "a.json").read_bytes() == content
    assert [path.name for path in tmp_path.iterdir()] == ["a.json"]


def test_an_error_names_the_final_file(tmp_path: Path) -> None:
    (tmp_path / "folder").mkdir()
    for path, kind in (
        (tmp_path / "none" / "a.json", FileNotFoundError),
        (tmp_path / "folder", IsADirectoryError),
    ):
        with pytest.raises(kind) as failed:
            replace_synced(path, b"{}")
        assert (failed.value.filename, failed.value.filename2) == (str(path), None)
        assert ".part" not in str(failed.value)
    assert [path.name for path in tmp_path.iterdir()] == ["folder"], "no temporary file is left"
