"""Check that each recording has its file with the acknowledged bytes, and each file its row."""

import hashlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from service.integrity.database_check import Rows
from service.integrity.finding import IS_LINK, REPAIR, Finding
from service.states import ACTIVE_STATES
from service.storage.data_folder import ID
from service.storage.rows import ViewRow

MIB = 1 << 20


@dataclass(frozen=True)
class FileHashes:
    """Size and hashes of a file."""

    size_bytes: int
    sha256: str
    """SHA-256 of the whole file."""
    ranges: tuple[str, ...]
    """SHA-256 of each requested range, as far as the file reaches."""


def hash_file(path: Path, ranges: Sequence[tuple[int, int]] = ()) -> FileHashes:
    """Hash a file and ranges of it, reading it once.

    Args:
        path: File.
        ranges: Offset and size of each range, bytes.

    Raises:
        OSError: The file cannot be read.
    """
    whole, parts = hashlib.sha256(), [hashlib.sha256() for _ in ranges]
    position = 0
    with path.open("rb") as file:
        while block := file.read(MIB):
            whole.update(block)
            for (offset, size), part in zip(ranges, parts, strict=True):
                part.update(block[max(0, offset - position) : max(0, offset + size - position)])
            position += len(block)
    return FileHashes(position, whole.hexdigest(), tuple(part.hexdigest() for part in parts))


def acknowledged_views(views: Sequence[ViewRow]) -> list[ViewRow]:
    """Return the views that are recorded by their rows, with a hash of their bytes."""
    return [view for view in views if view.state == "recorded" and view.sha256 is not None]


def find_lost_views(path: Path, views: Sequence[ViewRow]) -> tuple[FileHashes, list[ViewRow]]:
    """Return the hashes of a recording, and the acknowledged views that it does not hold as they were written.

    Args:
        path: File of the recording.
        views: Rows of its views.

    Raises:
        OSError: The file cannot be read.
    """
    expected = acknowledged_views(views)
    hashes = hash_file(path, [(view.offset_bytes or 0, view.size_bytes or 0) for view in expected])
    return hashes, [view for view, sha256 in zip(expected, hashes.ranges, strict=True) if view.sha256 != sha256]


def check_recordings(folder: Path, files: Sequence[Path], rows: Rows, quick: bool, running: bool) -> Iterator[Finding]:
    """Compare each recording with its file, and each file with the recordings.

    Args:
        folder: Folder of the recordings.
        files: Entries of `folder`, listed before the rows were read.
        rows: Rows of the database.
        quick: Compare sizes only.
        running: Whether a service runs. Files that it is writing are then not findings.

    Yields:
        Findings for missing and changed files, lost views, and files without a row.
    """
    for recording in rows.recordings.values():
        path = folder / f"{recording.id}.mcap"
        if not path.is_file() or path.is_symlink():
            advice = f"put the file back, or {REPAIR}: its row is removed"
            what = IS_LINK if path.is_symlink() else "the file is missing"
            yield Finding("recordings", "recording-missing", str(path), what, advice, True, path.stem)
            continue
        try:
            yield from _compare(path, recording.size_bytes, recording.sha256, rows.views.get(recording.id, ()), quick)
        except OSError as error:
            what = f"it cannot be read: {error.strerror or error}"
            yield Finding("recordings", "recording-changed", str(path), what, REPAIR, True, path.stem)
    for path in files:
        scan = rows.scans.get(path.stem)
        if path.suffix == ".mcap" and path.stem in rows.recordings:
            continue
        if path.suffix == ".mcap" and path.stem in rows.unreadable["recordings"]:
            continue  # its row is removed first
        active = scan is not None and scan.state in ACTIVE_STATES
        if running and (active or path.stem in rows.unreadable["scans"]):
            continue
        has_id = path.suffix == ".mcap" and ID.fullmatch(path.stem)
        advice = (
            f"{REPAIR}: it is adopted if it can be read, else moved to lost+found"
            if has_id
            else f"{REPAIR}: it is moved to lost+found"
        )
        what = "no database row refers to this file"
        yield Finding("recordings", "recording-without-row", str(path), what, advice, True, path.name)


def describe_change(size_bytes: int, written_bytes: int) -> str:
    """Return how a file differs from the written one, as a message."""
    if size_bytes == written_bytes:
        return f"its content has changed, at the same size of {size_bytes} bytes"
    return f"it has {size_bytes} bytes, and was written with {written_bytes}"


def _compare(path: Path, size_bytes: int, sha256: str, views: Sequence[ViewRow], quick: bool) -> Iterator[Finding]:
    advice = (
        f"put the original file back, or {REPAIR}: its row is corrected if the file can be read, else it is moved to "
        "lost+found and its row is removed"
    )
    size = path.stat().st_size
    if quick:
        if size != size_bytes:
            what = describe_change(size, size_bytes)
            yield Finding("recordings", "recording-changed", str(path), what, advice, True, path.stem)
        return
    hashes, lost = find_lost_views(path, views)
    for view in lost:  # repaired first, because the row of the recording takes its missing views from the rows of views
        what = f"it does not hold view {view.view} as it was acknowledged"
        yield Finding(
            "recordings", "view-lost", str(path), what, f"{REPAIR}: the view becomes missing", True,
            f"{view.scan}/{view.view}",
        )  # fmt: skip
    if (hashes.size_bytes, hashes.sha256) != (size_bytes, sha256):
        what = describe_change(hashes.size_bytes, size_bytes)
        expected = len(acknowledged_views(views))
        if expected:
            what += f"; {expected - len(lost)} of {expected} views are as they were acknowledged"
        yield Finding("recordings", "recording-changed", str(path), what, advice, True, path.stem)
