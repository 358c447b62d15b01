"""Check that each result of a scan or calibration has its files, and each folder its row."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from calibration.dataset.folder import HAND_EYE_FILE
from service.integrity.database_check import Rows
from service.integrity.finding import IS_LINK, REPAIR, Finding
from service.integrity.recording_check import describe_change, hash_file
from service.states import ACTIVE_STATES, RESULT_STATES
from service.storage.data_folder import CLOUD, HEIGHT_MAP, ID, MODEL, PREVIEW
from service.storage.rows import ScanRow


def check_results(folder: Path, paths: Sequence[Path], rows: Rows, quick: bool, running: bool) -> Iterator[Finding]:
    """Compare each scan that has a result with its files, and each path with the scans.

    Args:
        folder: Folder of the results.
        paths: Entries of `folder`, listed before the rows were read.
        rows: Rows of the database.
        quick: Compare sizes only.
        running: Whether a service runs. The files of its active scans are then not findings.

    Yields:
        One finding for each damaged result or unknown path.
    """
    for scan in rows.scans.values():
        if scan.state in RESULT_STATES:
            yield from _check_result(folder / scan.id, scan, quick)
    for path in paths:
        scan = rows.scans.get(path.name)
        if path.name in rows.unreadable["scans"]:
            continue  # its row is repaired first
        if scan is not None and (scan.state in RESULT_STATES or (running and scan.state in ACTIVE_STATES)):
            continue
        what = "no scan with a result refers to it"
        advice = f"{REPAIR}: it is moved to lost+found"
        yield Finding("results", "result-without-row", str(path), what, advice, True, path.name)


def _check_result(folder: Path, scan: ScanRow, quick: bool) -> Iterator[Finding]:
    """Yield the first damage only, because a result is repaired as a whole. Only its picture is repaired alone."""
    advice = (
        f"put it back, or {REPAIR}: the rest of the result is moved to lost+found, and the scan becomes failed; then "
        "reprocess it"
    )
    files = scan.files or {}
    for name in (MODEL, CLOUD, *({HEIGHT_MAP} & files.keys())):
        path = folder / name
        if folder.is_symlink() or not path.is_file() or path.is_symlink():
            what = IS_LINK if folder.is_symlink() or path.is_symlink() else "the file is missing"
            yield Finding("results", "result-missing", str(path), what, advice, True, scan.id)
            return
        if what := _change(path, files.get(name), quick):
            yield Finding("results", "result-changed", str(path), what, advice, True, scan.id)
            return
    # A result may have no picture. The thumbnail is made from it on request.
    picture = folder / PREVIEW
    if picture.is_symlink():
        what = IS_LINK
    elif not picture.exists():
        what = "the file is missing" if PREVIEW in files else ""
    else:
        what = _change(picture, files.get(PREVIEW), quick)
    if what:
        advice = f"put it back, or {REPAIR}: what is there is moved to lost+found, and the result has no picture"
        yield Finding("results", "picture-changed", str(picture), what, advice, True, scan.id)


def _change(path: Path, written: Mapping[str, Any] | None, quick: bool) -> str:
    """Return how a file differs from the written one, as a message. Empty: it does not, or that is not known."""
    if written is None:
        return ""
    try:
        size = path.stat().st_size
        same = size == written["size_bytes"] and (quick or hash_file(path).sha256 == written["sha256"])
    except OSError as error:
        return f"it cannot be read: {error.strerror or error}"
    return "" if same else describe_change(size, written["size_bytes"])


def check_calibrations(runs: Path, paths: Sequence[Path], rows: Rows, running: bool) -> Iterator[Finding]:
    """Compare each calibration that has a result with its file, and each folder named by an id with the rows.

    Calibrations made on the command line have names of another form and no row. They are skipped.

    Args:
        runs: Folder of the calibrations.
        paths: Entries of `runs`, listed before the rows were read.
        rows: Rows of the database.
        running: Whether a service runs. Its active calibrations are then not findings.

    Yields:
        One finding for each missing file, unfinished calibration or unknown folder.
    """
    for row in rows.calibrations.values():
        path = runs / row.id / HAND_EYE_FILE
        if row.kind == "calibration" and row.state == "succeeded" and not path.is_file():
            advice = f"put it back, or {REPAIR}: the calibration becomes failed; then calibrate again"
            yield Finding("calibrations", "calibration-missing", str(path), "the file is missing", advice, True, row.id)
        if not running and row.state in ACTIVE_STATES:
            what = f"its row says {row.state}, but no service runs"
            where, advice = f"{row.kind} {row.id}", f"start the service, or {REPAIR}"
            yield Finding("calibrations", "calibration-unfinished", where, what, advice, True, row.id)
    for path in paths:
        known = path.name in rows.calibrations or path.name in rows.unreadable["calibrations"]
        if ID.fullmatch(path.name) and not known:
            what, advice = "no database row refers to it", f"{REPAIR}: it is moved to lost+found"
            yield Finding("calibrations", "calibration-without-row", str(path), what, advice, True, path.name)
