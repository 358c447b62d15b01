"""The integrity check: compare the database with the files of the data folder. The check changes nothing."""

import shutil
import stat
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from service.config.loader import ServiceConfig
from service.integrity.database_check import Rows, check_database
from service.integrity.finding import REPAIR, Finding, Group
from service.integrity.recording_check import check_recordings
from service.integrity.result_check import check_calibrations, check_results
from service.security.auth.sessions import SESSIONS_FILE, read_sessions
from service.security.auth.tokens import TOKENS_FILE, TokensError, read_tokens
from service.states import ACTIVE_STATES
from service.storage.data_folder import DATABASE

ADD_TOKENS = "put back a copy, or remove it and add the tokens again: `pointchain token add`"
SIGN_IN_AGAIN = "put back a copy, or remove it; people who signed in with a code must then sign in again"


@dataclass(frozen=True)
class CheckTarget:
    """A data folder, and how to check it."""

    root: Path
    """The data folder."""
    runs: Path
    """Folder of the calibrations that the cell made."""
    min_free_bytes: int
    """Free space below which the service starts nothing."""
    quick: bool = False
    """Compare sizes only; read no file."""

    @property
    def database(self) -> Path:
        """File of the database."""
        return self.root / DATABASE


@dataclass(frozen=True)
class CheckReport:
    """Result of an integrity check."""

    findings: tuple[Finding, ...]
    checked: dict[Group, str]
    """Description of what was checked in each group. A group that could not be checked is absent."""
    service_runs: bool
    """Whether a service ran during the check. Its work in progress is then not a finding."""


def check_target(config: ServiceConfig, quick: bool = False) -> CheckTarget:
    """Return the configured data folder as a target of the check.

    Args:
        config: Configuration of the service.
        quick: Compare sizes only.
    """
    folder = config.cell.hand_eye.folder
    assert folder is not None, "the configuration of the service always names a folder"
    return CheckTarget(config.data_dir, folder / "runs", config.limits.min_free_bytes, quick)


def is_service_running(root: Path) -> bool:
    """Return whether a service holds the lock of the data folder. False where the system has no such lock."""
    try:
        import fcntl
    except ImportError:  # only POSIX has this lock
        return False
    try:
        with (root / "lock").open("rb") as file:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except FileNotFoundError:
        return False
    except BlockingIOError:
        return True
    return False


def check_store(store: CheckTarget, running: bool | None = None) -> CheckReport:
    """Return all findings of a data folder.

    While a service runs, rows and files may change during the check. The check then runs twice and reports only what
    both found.

    Args:
        store: The data folder.
        running: Whether a service runs, if the caller knows it, for example because it holds the lock itself. None:
            find out by the lock.

    Raises:
        OSError: The disk cannot be read.
    """
    report = _check_store_once(store, running)
    if not (report.service_runs and report.findings):
        return report
    second = _check_store_once(store, running)
    return replace(second, findings=tuple(finding for finding in second.findings if finding in report.findings))


def _check_store_once(store: CheckTarget, running: bool | None) -> CheckReport:
    root = store.root
    if not root.is_dir():
        what = "it is not a folder" if root.exists() else "the folder does not exist"
        advice = "set data_dir to the data folder; the service makes a new folder when it starts"
        return CheckReport((Finding("data folder", "folder-unusable", str(root), what, advice, False),), {}, False)
    running = is_service_running(root) if running is None else running
    # files are listed before rows, because a running service writes rows last
    recordings, results, runs = _entries(root / "recordings"), _entries(root / "scans"), _entries(store.runs)
    findings, checked = _leftovers(root, running), dict[Group, str]()
    checked["data folder"] = f"{root}" + (", in use by a service" if running else "")
    rows = _database(store, bool(recordings or results), findings, checked)
    if rows is not None:
        if not running:
            findings += _unfinished(rows)
        findings += check_recordings(root / "recordings", recordings, rows, store.quick, running)
        checked["recordings"] = f"{len(rows.recordings)} recordings"
        findings += check_results(root / "scans", results, rows, store.quick, running)
        checked["results"] = f"{len(rows.scans)} scans"
        # other services may use a folder outside the data folder
        own = runs if store.runs.is_relative_to(root) else []
        findings += check_calibrations(store.runs, own, rows, running)
        checked["calibrations"] = f"{len(rows.calibrations)} calibrations and verifications by the cell"
    service_path = store.database if store.database.exists() else root
    findings += _tokens(root / TOKENS_FILE, read_tokens, ADD_TOKENS, service_path)
    findings += _tokens(root / SESSIONS_FILE, read_sessions, SIGN_IN_AGAIN, service_path)
    private = [name for name in (TOKENS_FILE, SESSIONS_FILE) if (root / name).exists()]
    checked["tokens"] = ", ".join(private) or "no tokens yet"
    free = shutil.disk_usage(root).free
    checked["disk"] = f"{free / 2**30:.1f} GiB free"
    if free < store.min_free_bytes:
        what = f"{free / 2**20:.0f} MiB are free; starting a job needs {store.min_free_bytes / 2**20:.0f} MiB"
        advice = "free some space, let the retention remove old scans, or lower limits.min_free_bytes"
        findings.append(Finding("disk", "little-space", str(root), what, advice, False))
    return CheckReport(tuple(findings), checked, running)


def _entries(folder: Path) -> list[Path]:
    return sorted(folder.iterdir()) if folder.is_dir() else []


def _leftovers(root: Path, running: bool) -> list[Finding]:
    if running:
        return []
    what = "its writing was interrupted when a service ended"
    advice = f"{REPAIR}: it is moved to lost+found; a service removes it when it starts"
    return [
        Finding("data folder", "leftover", str(path), what, advice, True, path.name)
        for path in _entries(root / "incoming")
    ]


def _database(store: CheckTarget, has_files: bool, findings: list[Finding], checked: dict[Group, str]) -> Rows | None:
    if not store.database.exists():
        if has_files:
            advice = (
                f"put it back, or {REPAIR}: a new database adopts the recordings, and results are moved to lost+found"
            )
            where, what = str(store.database), "the database is missing, but there are recordings or results"
            findings.append(Finding("database", "database-missing", where, what, advice, True))
        else:
            checked["database"] = "no database yet"
        return None
    found, rows = check_database(store.database, store.quick)
    findings += found
    checked["database"] = f"{store.database.name}, " + ("quick check" if store.quick else "full check")
    return rows


def _unfinished(rows: Rows) -> list[Finding]:
    return [
        Finding(
            "database", "scan-unfinished", f"scan {scan.id}", f"its row says {scan.state}, but no service runs",
            f"start the service, or {REPAIR}: the scan becomes interrupted", True, scan.id,
        )
        for scan in rows.scans.values()
        if scan.state in ACTIVE_STATES
    ]  # fmt: skip


def _tokens(path: Path, read: Callable[[Path], object], advice: str, service_path: Path) -> list[Finding]:
    """Check a file of tokens or sessions; `service_path` is any path that belongs to the user of the service."""
    if not path.exists():
        return []
    found = []
    mode = stat.S_IMODE(path.stat().st_mode)
    if mode & 0o077:
        what = f"users other than its owner may read or change it (mode {mode:o})"
        found.append(Finding("tokens", "tokens-open", str(path), what, f"{REPAIR}, or chmod 600", True, path.name))
    try:
        read(path)
    except TokensError as error:
        found.append(Finding("tokens", "tokens-unreadable", str(path), str(error), advice, False))
    else:
        user, file = service_path.stat().st_uid, path.stat()
        # root reads every file, and the groups of the user are not known here
        if user != 0 and not mode & (0o400 if file.st_uid == user else 0o044):
            what = (
                f"the user of the service (uid {user}) cannot read it, because it belongs to uid {file.st_uid} and "
                f"has mode {mode:03o}: the service refuses the clients in it"
            )
            advice = f"give it to that user: `chown {user} {path}` and `chmod 600 {path}`"
            found.append(Finding("tokens", "tokens-unreadable", str(path), what, advice, False))
    return found
