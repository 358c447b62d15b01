"""Whether the store is whole: what the database tells, and what is there. Nothing is changed by looking."""

import shutil
import stat
from dataclasses import dataclass, replace
from pathlib import Path

from service.config.loader import ServiceConfig
from service.integrity.database_check import Rows, check_database
from service.integrity.finding import REPAIR, Finding, Group
from service.integrity.recording_check import check_recordings
from service.integrity.result_check import check_calibrations, check_results
from service.security.auth.tokens import FILE, TokensError, read_tokens
from service.states import ACTIVE_STATES
from service.storage.data_folder import DATABASE


@dataclass(frozen=True)
class Examined:
    """A store, and how to look at it."""

    root: Path
    """The data folder."""
    runs: Path
    """Where calibrations by the cell lie."""
    min_free_bytes: int
    quick: bool = False
    """Sizes only: no file is read."""

    @property
    def database(self) -> Path:
        """The database's file."""
        return self.root / DATABASE


@dataclass(frozen=True)
class Examination:
    """What was found."""

    findings: tuple[Finding, ...]
    looked_at: dict[Group, str]
    """What was looked at, in words, by what it is of; what is not among them could not be."""
    service_runs: bool
    """One did: what it was just about is no finding."""


def examined_by(config: ServiceConfig, quick: bool = False) -> Examined:
    """The configured store."""
    folder = config.cell.hand_eye.folder
    assert folder is not None, "the service's configuration always names one"
    return Examined(config.data_dir, folder / "runs", config.limits.min_free_bytes, quick)


def service_runs(root: Path) -> bool:
    """A service has the data folder's lock."""
    try:
        import fcntl
    except ImportError:  # not POSIX: there is no lock
        return False
    try:
        with (root / "lock").open("rb") as file:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except FileNotFoundError:
        return False
    except BlockingIOError:
        return True
    return False


def examine(store: Examined, running: bool | None = None) -> Examination:
    """All findings. `running` where it is known whether a service runs, as when the lock is one's own.

    Raises:
        OSError: the disk cannot be read.
    """
    found = _examine(store, running)
    if not (found.service_runs and found.findings):
        return found
    # Rows and files may have come and gone while they were looked at: what is found twice is so.
    again = _examine(store, running)
    return replace(again, findings=tuple(finding for finding in again.findings if finding in found.findings))


def _examine(store: Examined, running: bool | None) -> Examination:
    root = store.root
    if not root.is_dir():
        what = "it is no folder" if root.exists() else "there is no such folder"
        advice = "set data_dir to where it is; a service that starts makes a new one"
        return Examination((Finding("data folder", "folder-unusable", str(root), what, advice, False),), {}, False)
    running = service_runs(root) if running is None else running
    # Files before rows: a service that is at work writes rows last.
    recordings, results, runs = _listed(root / "recordings"), _listed(root / "scans"), _listed(store.runs)
    findings, looked_at = _leftovers(root, running), dict[Group, str]()
    looked_at["data folder"] = f"{root}" + (", in use by a service" if running else "")
    rows = _database(store, bool(recordings or results), findings, looked_at)
    if rows is not None:
        if not running:
            findings += _unfinished(rows)
        findings += check_recordings(root / "recordings", recordings, rows, store.quick, running)
        looked_at["recordings"] = f"{len(rows.recordings)} recordings"
        findings += check_results(root / "scans", results, rows, store.quick, running)
        looked_at["results"] = f"{len(rows.scans)} scans"
        # A folder elsewhere may be other services' too.
        own = runs if store.runs.is_relative_to(root) else []
        findings += check_calibrations(store.runs, own, rows, running)
        looked_at["calibrations"] = f"{len(rows.calibrations)} calibrations and verifications by the cell"
    findings += _tokens(root / FILE, store.database if store.database.exists() else root)
    looked_at["tokens"] = FILE if (root / FILE).exists() else "there are none"
    free = shutil.disk_usage(root).free
    looked_at["disk"] = f"{free / 2**30:.1f} GiB free"
    if free < store.min_free_bytes:
        what = f"{free / 2**20:.0f} MiB are free, {store.min_free_bytes / 2**20:.0f} MiB needed to begin anything"
        advice = "free some space, have old scans removed (retention), or set limits.min_free_bytes lower"
        findings.append(Finding("disk", "little-space", str(root), what, advice, False))
    return Examination(tuple(findings), looked_at, running)


def _listed(folder: Path) -> list[Path]:
    return sorted(folder.iterdir()) if folder.is_dir() else []


def _leftovers(root: Path, running: bool) -> list[Finding]:
    if running:
        return []
    what = "it was being written when a service ended"
    advice = f"{REPAIR}: it is put aside; a service that starts removes it"
    return [
        Finding("data folder", "leftover", str(path), what, advice, True, path.name)
        for path in _listed(root / "incoming")
    ]


def _database(store: Examined, files: bool, findings: list[Finding], looked_at: dict[Group, str]) -> Rows | None:
    if not store.database.exists():
        if files:
            advice = f"put it back, or {REPAIR}: recordings are taken into a new one, results put aside"
            where, what = str(store.database), "there is no database, but files that it should tell of"
            findings.append(Finding("database", "database-missing", where, what, advice, True))
        else:
            looked_at["database"] = "there is none yet"
        return None
    found, rows = check_database(store.database, store.quick)
    findings += found
    looked_at["database"] = f"{store.database.name}, " + ("quick check" if store.quick else "full check")
    return rows


def _unfinished(rows: Rows) -> list[Finding]:
    return [
        Finding(
            "database", "scan-unfinished", f"scan {scan.id}", f"it is {scan.state} by its row, but no service runs",
            f"start the service, or {REPAIR}: it becomes interrupted", True, scan.id,
        )
        for scan in rows.scans.values()
        if scan.state in ACTIVE_STATES
    ]  # fmt: skip


def _tokens(path: Path, of_service: Path) -> list[Finding]:
    """Check the file of tokens; `of_service` is a path that belongs to the user of the service."""
    if not path.exists():
        return []
    found = []
    mode = stat.S_IMODE(path.stat().st_mode)
    if mode & 0o077:
        what = f"others than its owner may read or change it (mode {mode:o})"
        found.append(Finding("tokens", "tokens-open", str(path), what, f"{REPAIR}, or chmod 600", True))
    try:
        read_tokens(path)
    except TokensError as error:
        advice = "put back a copy, or remove it and add the tokens anew: `pointchain token add`"
        found.append(Finding("tokens", "tokens-unreadable", str(path), str(error), advice, False))
    else:
        user, file = of_service.stat().st_uid, path.stat()
        # Root reads every file, and the groups of the user are not known here.
        if user != 0 and not mode & (0o400 if file.st_uid == user else 0o044):
            what = (
                f"the user of the service (uid {user}) cannot read it, since it belongs to uid {file.st_uid} and has "
                f"mode {mode:03o}: the service refuses every client"
            )
            advice = f"give it to that user: `chown {user} {path}` and `chmod 600 {path}`"
            found.append(Finding("tokens", "tokens-unreadable", str(path), what, advice, False))
    return found
