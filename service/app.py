"""The HTTP service as an ASGI application."""

import asyncio
import json
import sys
from collections.abc import AsyncIterator
from contextlib import ExitStack, asynccontextmanager

from anyio import CapacityLimiter, to_thread
from fastapi import Depends, FastAPI
from starlette.staticfiles import StaticFiles

from cell.control.cell import Cell
from service.api.dependencies import Context
from service.api.image_cache import Pictures
from service.api.openapi import describe_better, operation_id
from service.api.problem_handlers import install_problem_handlers
from service.api.response_cache import Reading
from service.api.routes import (
    calibration,
    cell,
    console,
    docs,
    events,
    health,
    manual,
    recordings,
    results,
    scans,
    session,
    views,
)
from service.api.routes import metrics as metrics_route
from service.api.schemas.addresses import RECORDINGS
from service.api.stop_priority import StopFirst
from service.api.strict_query import refuse_unknown
from service.config.loader import ServiceConfig, load_config
from service.events.cell_events import publish_changes
from service.events.stream_slots import StreamSlots
from service.jobs.manager import Jobs
from service.metrics.registry import Metrics
from service.metrics.requests import RequestWatch
from service.metrics.scans import ScanMetrics
from service.metrics.state import StateMetrics
from service.security.audit.log import SERVICE, AuditLog
from service.security.auth.roles import CONSOLE_FILES, DOCS_FILES, MANUAL
from service.security.middleware.install import install_security
from service.server.event_loop_watchdog import LoopWatch
from service.storage.data_folder import DataFolder
from service.storage.fault_memory import FaultMemory
from service.storage.idempotency_keys import IdempotencyKeys
from service.storage.retention import Retention
from service.storage.store import Store

API_VERSION = "1"

DESCRIPTION = """Strings, cables and ropes as ordered 3D point chains.

Start a live scan by the cell, or upload a recording and start a scan of it; follow the scan until its state is final,
and fetch its model.
Metres, radians and seconds everywhere. Errors are `application/problem+json` (RFC 9457); decide on their
`type`. A request that is as described here is never refused as `invalid-request`; it can be for what it refers to.
"""


STOPS = 100
"""So many stops and cancels are seen to at the same time; each may wait some seconds for its scan's end."""


def create_app(config: ServiceConfig) -> FastAPI:
    """The application; the data folder and the recognition process are taken when it starts, not here."""

    metrics, audit = Metrics(), AuditLog()

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        app.state.context = context = await to_thread.run_sync(_open, config, metrics.scans, audit)
        jobs, streams = context.jobs, context.streams
        metrics.watch(
            StateMetrics(context.cell, context.store.folder, lambda: jobs.recognition_starts, lambda: streams.open)
        )
        audit.start(context.store.folder.database, lambda: context.cell.status.state)
        audit.note(SERVICE, "start")
        watch = LoopWatch(asyncio.get_running_loop(), jobs.stop_unattended)
        try:
            yield
        finally:
            watch.close()
            # A thread of its own: requests that were given up may still hold all others.
            await to_thread.run_sync(_close, context, audit, limiter=CapacityLimiter(1))

    app = FastAPI(
        title="Pointchain",
        version=API_VERSION,
        description=DESCRIPTION,
        lifespan=lifespan,
        dependencies=[Depends(refuse_unknown)],
        openapi_url=None,  # description and page are ours, the page's files are a library's
        generate_unique_id_function=operation_id,
    )
    app.mount(CONSOLE_FILES, console.FILES)
    app.mount(MANUAL, manual.FILES)
    app.mount(DOCS_FILES, StaticFiles(packages=[("fastapi_offline", "static")]))
    app.state.audit = audit
    describe_better(app)
    app.add_middleware(StopFirst)  # inside the gate: who may not stop anything holds nobody up
    install_security(app, config, audit, upload_path=RECORDINGS)
    app.state.metrics = metrics
    app.add_middleware(RequestWatch, metrics=metrics.requests)  # added last, it is outside of all others
    install_problem_handlers(app)
    # In this order they are looked for: what is asked for most comes first.
    for resource in (scans, cell, results, views, recordings, calibration, events, session, health, metrics_route):
        app.include_router(resource.router)
    for page in (console, docs, manual):
        app.include_router(page.router)
    return app


def _open(config: ServiceConfig, metrics: ScanMetrics, audit: AuditLog) -> Context:
    with ExitStack() as if_it_fails:
        folder = DataFolder(config.data_dir)
        if_it_fails.callback(folder.close)
        store = Store(folder)
        if_it_fails.callback(store.close)
        own = Cell(config.cell)
        if_it_fails.callback(own.close)
        publish_changes(own, store.events.hub)
        # Before anything starts a process: while OpenCV is loaded, its own folder is where a child would look first.
        pictures = Pictures()
        fault = FaultMemory(store.database, own, lambda slug: audit.note(SERVICE, "fault", result=slug))
        if_it_fails.callback(fault.close)
        jobs = Jobs(store, own, config.limits.recognition_s, config.gripper.value, metrics)
        if_it_fails.callback(jobs.close)
        retention = Retention(store, config.retention, lambda: jobs.idle)
        if_it_fails.pop_all()
    return Context(
        config,
        store,
        own,
        jobs,
        parsing=CapacityLimiter(1),
        uploads=CapacityLimiter(recordings.UPLOADS),
        planning=CapacityLimiter(1),
        stopping=CapacityLimiter(STOPS),
        pictures=pictures,
        keys=IdempotencyKeys(store),
        retention=retention,
        streams=StreamSlots(config.limits.event_streams, config.limits.event_streams_each),
        reading=Reading(store.database),
        fault=fault,
    )


def _close(context: Context, audit: AuditLog) -> None:
    """Closes all, the last to be opened first; what one of them raises keeps none of the others open."""
    with ExitStack() as opened:
        for part in (context.store.folder, context.store, context.reading, audit):
            opened.callback(part.close)
        opened.callback(audit.note, SERVICE, "end")
        for part in (context.fault, context.cell, context.jobs, context.retention):
            opened.callback(part.close)


def openapi_document() -> str:
    """The description of the API, as committed in openapi.json."""
    return json.dumps(create_app(load_config()).openapi(), indent=2) + "\n"


if __name__ == "__main__":
    sys.stdout.write(openapi_document())
