"""Whether the service can do what it is for: each thing that it takes, by its name."""

import logging
import shutil
import sqlite3

from service.api.dependencies import Context
from service.api.schemas.health import ReadinessCheck, ReadinessChecks
from service.security.auth.tokens import FILE, TokensError, read_tokens
from service.storage.database import Database

log = logging.getLogger(__name__)

WRITABLE_MS = 1000
"""The database may be held by somebody else for so long; a request that writes waits longer."""


def readiness(service: Context) -> ReadinessChecks:
    """All of it as it is now. May block for about a second.

    The cell is told but does not count: one that is not connected yet, or in a fault, is connected or acknowledged
    over this very service. Whoever takes a service that is not ready out of use would take that away.
    """
    return ReadinessChecks(
        store=_store(service.store.database),
        recognition=_well_unless(service.jobs.not_ready, "it waits for work, or is at it"),
        disk=_disk(service),
        service=_well_unless(_no_requests(service), "it takes requests"),
        cell=service.cell.status.state,
    )


def what_is_not(checks: ReadinessChecks) -> list[str]:
    """Each check that failed, in words."""
    named = {"store": checks.store, "recognition": checks.recognition, "disk": checks.disk, "service": checks.service}
    return [f"{name}: {check.words}" for name, check in named.items() if not check.ok]


def _no_requests(service: Context) -> str | None:
    """Return why the service takes no requests, or None if it takes them."""
    if service.jobs.closed:
        return "the service is stopping"
    path = service.store.folder.root / FILE
    try:
        read_tokens(path)
    except TokensError as error:
        log.warning("the tokens cannot be read: %s", error)
        # The answer is open to everyone, so that it does not name the folder.
        reason = str(error).replace(str(path), FILE)
        return f"{reason}; clients may be refused, also when they stop the arm"
    return None


def _store(database: Database) -> ReadinessCheck:
    """A change is begun, as every request that counts does, and not made."""
    try:
        with database.connection() as db:
            (usual,) = db.execute("PRAGMA busy_timeout").fetchone()
            db.execute(f"PRAGMA busy_timeout = {WRITABLE_MS}")
            try:
                db.execute("BEGIN IMMEDIATE")
                db.execute("ROLLBACK")
            finally:
                db.execute(f"PRAGMA busy_timeout = {usual}")
    except sqlite3.Error as error:
        log.warning("the store cannot be written: %s", error)
        return ReadinessCheck(ok=False, words=f"it takes no changes: {error}")
    return ReadinessCheck(ok=True, words="it takes changes")


def _disk(service: Context) -> ReadinessCheck:
    needed = service.config.limits.min_free_bytes
    try:
        free = shutil.disk_usage(service.store.folder.root).free
    except OSError as error:
        return ReadinessCheck(ok=False, words=f"the data folder cannot be looked at: {error.strerror or error}")
    words = f"{free / 2**20:.0f} MiB are free, {needed / 2**20:.0f} MiB needed"
    return ReadinessCheck(ok=free >= needed, words=words)


def _well_unless(reason: str | None, words: str) -> ReadinessCheck:
    return ReadinessCheck(ok=reason is None, words=reason or words)
