"""Routes of liveness and readiness. Readiness has one named check for each part that a scan needs."""

import logging
import os
import shutil
import sqlite3
from typing import Any

from fastapi import APIRouter, Response
from fastapi.responses import JSONResponse

from service.api.dependencies import Context, Service
from service.api.problem_responses import problem_responses
from service.api.schemas.health import Health, Readiness, ReadinessCheck, ReadinessChecks
from service.problems.document import MEDIA_TYPE, problem_document
from service.security.auth.sessions import SESSIONS_FILE, read_sessions
from service.security.auth.tokens import TOKENS_FILE, TokensError, read_tokens
from service.storage.database import Database

log = logging.getLogger(__name__)

router = APIRouter(tags=["health"])

WRITE_TIMEOUT_MS = 1000
"""Time to wait for the database while another program locks it. A request that writes waits longer."""


@router.get("/healthz", responses=problem_responses())
async def healthz() -> Health:
    """Answer 200 while the event loop runs. Nothing else is checked or waited for."""
    return Health()


@router.get("/readyz", response_model=Readiness, responses=problem_responses("not-ready"))
def readyz(service: Service) -> Any:
    """Answer 200 if the service can run a scan, otherwise 503 with the checks that failed.

    The service is ready if the database accepts changes, recognition is ready or at work, the disk has space, the
    service is not stopping, and its files of tokens and sessions can be read. The state of the cell is reported but
    does not count; see `GET /api/cell`.
    """
    checks = _run_checks(service)
    failed = _failed_checks(checks)
    return Readiness(checks=checks) if not failed else _not_ready("; ".join(failed), checks.model_dump())


def _not_ready(detail: str, checks: dict[str, Any]) -> Response:
    problem = problem_document("not-ready", detail, "/readyz", checks=checks)
    return JSONResponse(problem, problem["status"], headers={"Retry-After": "1"}, media_type=MEDIA_TYPE)


def _run_checks(service: Context) -> ReadinessChecks:
    """Run all checks. May block for about a second.

    The state of the cell is reported but does not count. A cell that is not connected, or in a fault, is connected or
    acknowledged through this service, so an orchestrator must not take the service out of use for that.
    """
    disk, free_bytes = _disk(service)
    return ReadinessChecks(
        store=_store(service.store.database, free_bytes),
        recognition=_check(service.jobs.not_ready, "it is ready, or at work"),
        disk=disk,
        service=_check(_refusal_reason(service), "it accepts requests"),
        cell=service.cell.status.state,
    )


def _failed_checks(checks: ReadinessChecks) -> list[str]:
    """Return a message for each check that failed."""
    named = {"store": checks.store, "recognition": checks.recognition, "disk": checks.disk, "service": checks.service}
    return [f"{name}: {check.message}" for name, check in named.items() if not check.ok]


def _refusal_reason(service: Context) -> str | None:
    """Return why the service accepts no requests, or None if it accepts them."""
    if service.jobs.closed:
        return "the service is stopping"
    root = service.store.folder.root
    try:
        read_tokens(root / TOKENS_FILE)
        read_sessions(root / SESSIONS_FILE)
    except TokensError as error:
        log.warning("the tokens or sessions cannot be read: %s", error)
        # without the folder, because everyone may read the answer
        reason = str(error).replace(f"{root}{os.sep}", "")
        return f"{reason}; clients may be refused, also when they stop the arm"
    return None


def _store(database: Database, free_bytes: int) -> ReadinessCheck:
    """Check that the database accepts changes: begin a transaction, as every writing request does, and roll it back.

    Only the end of a transaction would show that the disk is full.
    """
    if free_bytes == 0:
        return ReadinessCheck(ok=False, message="it accepts no changes: the disk is full")
    try:
        with database.connection() as db:
            (original_ms,) = db.execute("PRAGMA busy_timeout").fetchone()
            db.execute(f"PRAGMA busy_timeout = {WRITE_TIMEOUT_MS}")
            try:
                db.execute("BEGIN IMMEDIATE")
                db.execute("ROLLBACK")
            finally:
                db.execute(f"PRAGMA busy_timeout = {original_ms}")
    except sqlite3.Error as error:
        log.warning("the store cannot be written: %s", error)
        return ReadinessCheck(ok=False, message=f"it accepts no changes: {error}")
    return ReadinessCheck(ok=True, message="it accepts changes")


def _disk(service: Context) -> tuple[ReadinessCheck, int]:
    """Return the check, and the free space in bytes."""
    needed = service.config.limits.min_free_bytes
    try:
        free = shutil.disk_usage(service.store.folder.root).free
    except OSError as error:
        return ReadinessCheck(ok=False, message=f"the data folder cannot be read: {error.strerror or error}"), 0
    status = f"{free / 2**20:.0f} MiB are free, {needed / 2**20:.0f} MiB are needed"
    return ReadinessCheck(ok=free >= max(needed, 1), message=status), free


def _check(reason: str | None, message: str) -> ReadinessCheck:
    return ReadinessCheck(ok=reason is None, message=reason or message)
