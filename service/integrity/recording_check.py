"""Recordings: each row has its file, with the bytes that were acknowledged, and each file its row."""

import hashlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from service.integrity.database_check import Rows
from service.integrity.finding import REPAIR, Finding
from service.states import ACTIVE_STATES
from service.storage.data_folder import ID
from service.storage.rows import ViewRow

MIB = 1 << 20


@dataclass(frozen=True)
class FileHashes:
    """What a file is made of."""

    size_bytes: int
    sha256: str
    pieces: tuple[str, ...]
    """SHA-256 of each piece that was asked for, as far as it is there."""


def hash_file(path: Path, pieces: Sequence[tuple[int, int]] = ()) -> FileHashes:
    """Of the whole, read once, and of `pieces`, each by its offset and size in bytes. Raises OSError."""
    whole, parts = hashlib.sha256(), [hashlib.sha256() for _ in pieces]
    at = 0
    with path.open("rb") as file:
        while block := file.read(MIB):
            whole.update(block)
            for (offset, size), part in zip(pieces, parts, strict=True):
                part.update(block[max(0, offset - at) : max(0, offset + size - at)])
            at += len(block)
    return FileHashes(at, whole.hexdigest(), tuple(part.hexdigest() for part in parts))


def acknowledged(views: Sequence[ViewRow]) -> list[ViewRow]:
    """Those that are on the disk by their rows, with a hash of their bytes."""
    return [view for view in views if view.state == "recorded" and view.sha256 is not None]


def lost_views(path: Path, views: Sequence[ViewRow]) -> tuple[FileHashes, list[ViewRow]]:
    """The file's hashes, and which acknowledged views are not in it as they were written. Raises OSError."""
    kept = acknowledged(views)
    hashes = hash_file(path, [(view.offset_bytes or 0, view.size_bytes or 0) for view in kept])
    return hashes, [view for view, sha256 in zip(kept, hashes.pieces, strict=True) if view.sha256 != sha256]


def check_recordings(folder: Path, files: Sequence[Path], rows: Rows, quick: bool, running: bool) -> Iterator[Finding]:
    """Each row against its file, and each of `files` against the rows; those were listed before the rows were read.

    `running`: a service may be at work; what it has just begun to write is well.
    """
    for recording in rows.recordings.values():
        path = folder / f"{recording.id}.mcap"
        if not path.is_file() or path.is_symlink():
            advice = f"put the file back, or {REPAIR}: its row is put aside"
            yield Finding(
                "recordings", "recording-missing", str(path), "there is no such file", advice, True, path.stem
            )
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
            continue  # that row is put aside first
        under_way = scan is not None and scan.state in ACTIVE_STATES
        if running and (under_way or path.stem in rows.unreadable["scans"]):
            continue
        known = path.suffix == ".mcap" and ID.fullmatch(path.stem)
        advice = (
            f"{REPAIR}: it is taken in if it can be read, else put aside" if known else f"{REPAIR}: it is put aside"
        )
        yield Finding(
            "recordings", "recording-without-row", str(path), "no row tells of this file", advice, True, path.name
        )


def changed(size_bytes: int, written_bytes: int) -> str:
    """How a file differs from what was written, in words."""
    if size_bytes == written_bytes:
        return f"its content has changed, at the same size of {size_bytes} bytes"
    return f"it has {size_bytes} bytes, and was written with {written_bytes}"


def _compare(path: Path, size_bytes: int, sha256: str, views: Sequence[ViewRow], quick: bool) -> Iterator[Finding]:
    advice = (
        f"put the file back as it was, or {REPAIR}: its row is corrected if the file can be read, else both are put "
        "aside"
    )
    size = path.stat().st_size
    if quick:
        if size != size_bytes:
            what = changed(size, size_bytes)
            yield Finding("recordings", "recording-changed", str(path), what, advice, True, path.stem)
        return
    hashes, lost = lost_views(path, views)
    for view in lost:  # first: what the recording's row says is missing is taken from theirs
        what = f"view {view.view} is not in it as it was acknowledged"
        yield Finding(
            "recordings", "view-lost", str(path), what, f"{REPAIR}: the view becomes missing", True,
            f"{view.scan}/{view.view}",
        )  # fmt: skip
    if (hashes.size_bytes, hashes.sha256) != (size_bytes, sha256):
        what = changed(hashes.size_bytes, size_bytes)
        kept = len(acknowledged(views)) - len(lost)
        if acknowledged(views):
            what += f"; {kept} of {len(acknowledged(views))} views are as they were acknowledged"
        yield Finding("recordings", "recording-changed", str(path), what, advice, True, path.stem)
