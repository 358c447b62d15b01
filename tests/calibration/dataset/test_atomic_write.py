"""Files that survive a loss of power; what cannot be written is told by the name that a person knows."""

from pathlib import Path

import pytest

from calibration.dataset.atomic_write import replace_synced


def test_a_file_is_replaced_whole(tmp_path: Path) -> None:
    for content in (b"first, and longer", b"second"):
        replace_synced(tmp_path / "a.json", content)
        assert (tmp_path / "a.json").read_bytes() == content
    assert [path.name for path in tmp_path.iterdir()] == ["a.json"]


def test_what_cannot_be_written_is_named(tmp_path: Path) -> None:
    (tmp_path / "folder").mkdir()
    for path, kind in (
        (tmp_path / "none" / "a.json", FileNotFoundError),
        (tmp_path / "folder", IsADirectoryError),
    ):
        with pytest.raises(kind) as failed:
            replace_synced(path, b"{}")
        assert (failed.value.filename, failed.value.filename2) == (str(path), None)
        assert ".part" not in str(failed.value)
    assert [path.name for path in tmp_path.iterdir()] == ["folder"], "nothing is left beside it"
