"""Results of scans and of calibrations: each row has its files, and each folder its row."""

from collections.abc import Iterator, Sequence
from pathlib import Path

from calibration.dataset.folder import HAND_EYE_FILE
from service.integrity.database_check import Rows
from service.integrity.finding import REPAIR, Finding
from service.integrity.recording_check import changed, hash_file
from service.states import ACTIVE_STATES, RESULT_STATES
from service.storage.data_folder import CLOUD, ID, MODEL
from service.storage.rows import ScanRow


def check_results(folder: Path, found: Sequence[Path], rows: Rows, quick: bool, running: bool) -> Iterator[Finding]:
    """Each scan that has a result against its files, and each of `found`, listed before, against the scans."""
    for scan in rows.scans.values():
        if scan.state in RESULT_STATES:
            yield from _compare(folder / scan.id, scan, quick)
    for path in found:
        scan = rows.scans.get(path.name)
        if path.name in rows.unreadable["scans"]:
            continue  # that row is corrected first
        if scan is not None and (scan.state in RESULT_STATES or (running and scan.state in ACTIVE_STATES)):
            continue
        what = "no scan with a result tells of it"
        yield Finding("results", "result-without-row", str(path), what, f"{REPAIR}: it is put aside", True, path.name)


def _compare(folder: Path, scan: ScanRow, quick: bool) -> Iterator[Finding]:
    """The first thing that is wrong: it is one result."""
    advice = (
        f"put it back, or {REPAIR}: what there is of the result is put aside, and the scan becomes failed; reprocess "
        "it then"
    )
    for name in (MODEL, CLOUD):
        path = folder / name
        if folder.is_symlink() or not path.is_file() or path.is_symlink():
            yield Finding("results", "result-missing", str(path), "there is no such file", advice, True, scan.id)
            return
        told = (scan.files or {}).get(name)
        if told is None:
            continue
        try:
            size = path.stat().st_size
            same = size == told["size_bytes"] and (quick or hash_file(path).sha256 == told["sha256"])
            what = changed(size, told["size_bytes"])
        except OSError as error:
            same, what = False, f"it cannot be read: {error.strerror or error}"
        if not same:
            yield Finding("results", "result-changed", str(path), what, advice, True, scan.id)
            return


def check_calibrations(runs: Path, found: Sequence[Path], rows: Rows, running: bool) -> Iterator[Finding]:
    """Each calibration that has a result against its file, and each folder with the name of one against the rows.

    Those that the command line made have names of another form, and no row.
    """
    for row in rows.calibrations.values():
        path = runs / row.id / HAND_EYE_FILE
        if row.kind == "calibration" and row.state == "succeeded" and not path.is_file():
            advice = f"put it back, or {REPAIR}: the calibration becomes failed; calibrate again then"
            yield Finding(
                "calibrations", "calibration-missing", str(path), "there is no such file", advice, True, row.id
            )
        if not running and row.state in ACTIVE_STATES:
            what = f"it is {row.state} by its row, but no service runs"
            where, advice = f"{row.kind} {row.id}", f"start the service, or {REPAIR}"
            yield Finding("calibrations", "calibration-unfinished", where, what, advice, True, row.id)
    for path in found:
        known = path.name in rows.calibrations or path.name in rows.unreadable["calibrations"]
        if ID.fullmatch(path.name) and not known:
            advice = f"{REPAIR}: it is put aside"
            yield Finding(
                "calibrations", "calibration-without-row", str(path), "no row tells of it", advice, True, path.name
            )
