"""The HTTP service as an ASGI application: `create_app` builds it, and `python -m service.app` prints its OpenAPI."""

import asyncio
import sys
from collections.abc import AsyncIterator
from contextlib import ExitStack, asynccontextmanager

from anyio import CapacityLimiter, to_thread
from fastapi import Depends, FastAPI
from starlette.staticfiles import StaticFiles

from cell.control.cell import Cell
from service.api.dependencies import Context
from service.api.head_requests import HeadRequests
from service.api.images.image_cache import ImageCache
from service.api.openapi import format_json, operation_id, refine_openapi
from service.api.problem_handlers import install_problem_handlers
from service.api.response_cache import ResponseCache
from service.api.routes import (
    calibration,
    cell,
    console,
    docs,
    events,
    grasps,
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
from service.api.stop_priority import StopPriority
from service.api.strict_request import reject_other_encodings, reject_unfit_parameters
from service.config.loader import ServiceConfig, load_config
from service.events.cell_events import publish_changes
from service.events.stream_slots import StreamSlots
from service.jobs.manager import Jobs
from service.metrics.registry import Metrics
from service.metrics.requests import AccessLogMiddleware
from service.metrics.scans import ScanMetrics
from service.metrics.state import StateMetrics
from service.processing.reach_finder import ReachFinder
from service.security.audit.log import SERVICE, AuditLog
from service.security.auth.roles import CONSOLE_FILES, DOCS_FILES, MANUAL
from service.security.middleware.install import install_security
from service.server.event_loop_watchdog import EventLoopWatchdog
from service.storage.data_folder import DataFolder
from service.storage.fault_store import FaultStore
from service.storage.idempotency_keys import IdempotencyKeys
from service.storage.retention import Retention
from service.storage.store import Store

API_VERSION = "1"
"""Version of the HTTP API."""

DESCRIPTION = """Strings, cables and ropes as ordered 3D point chains.

Start a live scan by the cell, or upload a recording and start a scan of it; follow the scan until its state is final,
and fetch its model.
Metres, radians and seconds everywhere. Errors are `application/problem+json` (RFC 9457); decide on their
`type`. A request that matches this description is never refused as `invalid-request`; it can still be refused for what
it refers to.
"""

MAX_CONCURRENT_STOPS = 100
"""Maximum number of stops and cancels at the same time. Each may wait some seconds for the end of its scan."""


def create_app(config: ServiceConfig) -> FastAPI:
    """Create the application. Its start, not this call, opens the data folder and starts the recognition process."""
    metrics, audit = Metrics(), AuditLog()

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        app.state.context = context = await to_thread.run_sync(_open, config, metrics.scans, audit)
        jobs, streams = context.jobs, context.streams
        metrics.register(
            StateMetrics(context.cell, context.store.folder, lambda: jobs.recognition_starts, lambda: streams.open)
        )
        audit.start(context.store.database.connect, lambda: context.cell.status.state)
        audit.add(SERVICE, "start")
        watchdog = EventLoopWatchdog(asyncio.get_running_loop(), jobs.stop_unattended)
        try:
            yield
        finally:
            watchdog.close()
            # its own thread, because cancelled requests may still hold all others
            await to_thread.run_sync(_close, context, audit, limiter=CapacityLimiter(1))

    app = FastAPI(
        title="Pointchain",
        version=API_VERSION,
        description=DESCRIPTION,
        servers=[{"url": "/"}],
        license_info={"name": "Apache License 2.0", "identifier": "Apache-2.0"},
        lifespan=lifespan,
        dependencies=[Depends(reject_unfit_parameters), Depends(reject_other_encodings)],
        openapi_url=None,  # the routes in `docs` serve the description and its page
        generate_unique_id_function=operation_id,
    )
    app.mount(CONSOLE_FILES, console.FILES)
    app.mount(MANUAL, manual.FILES)
    app.mount(DOCS_FILES, StaticFiles(packages=[("fastapi_offline", "static")]))
    app.state.audit = audit
    refine_openapi(app)
    app.add_middleware(StopPriority)  # inside the security layer: unauthorised stops delay no other request
    install_security(app, config, audit, upload_path=RECORDINGS)
    app.add_middleware(HeadRequests)  # outside the security layer, which has no calls with HEAD
    app.state.metrics = metrics
    app.add_middleware(AccessLogMiddleware, metrics=metrics.requests)  # added last, so it is the outermost
    install_problem_handlers(app)
    # Starlette matches routes in this order, so the most frequent ones come first.
    for resource in (
        *(scans, cell, results, grasps, views, recordings, calibration, events, session, health),
        metrics_route,
    ):
        app.include_router(resource.router)
    for page in (console, docs, manual):
        app.include_router(page.router)
    return app


def _open(config: ServiceConfig, metrics: ScanMetrics, audit: AuditLog) -> Context:
    with ExitStack() as cleanup:
        folder = DataFolder(config.data_dir)
        cleanup.callback(folder.close)
        store = Store(folder)
        cleanup.callback(store.close)
        robot_cell = Cell(config.cell)
        cleanup.callback(robot_cell.close)
        publish_changes(robot_cell, store.events.hub)
        # before any process starts: while OpenCV is loaded, its folder comes first in the search path of a child
        image_cache = ImageCache()
        fault = FaultStore(store.database, robot_cell, lambda slug: audit.add(SERVICE, "fault", result=slug))
        cleanup.callback(fault.close)
        jobs = Jobs(store, robot_cell, config.limits.recognition_s, metrics)
        cleanup.callback(jobs.close)
        retention = Retention(store, config.retention, lambda: jobs.idle)
        cleanup.pop_all()
    return Context(
        config,
        store,
        robot_cell,
        jobs,
        parsing=CapacityLimiter(1),
        uploads=CapacityLimiter(recordings.MAX_UPLOADS),
        planning=CapacityLimiter(1),
        stopping=CapacityLimiter(MAX_CONCURRENT_STOPS),
        image_cache=image_cache,
        keys=IdempotencyKeys(store),
        retention=retention,
        streams=StreamSlots(config.limits.event_streams, config.limits.event_streams_each),
        response_cache=ResponseCache(store.database),
        fault=fault,
        reach=ReachFinder(config.cell),
    )


def _close(context: Context, audit: AuditLog) -> None:
    """Close all parts in reverse order of opening. An error of one part leaves no other part open."""
    with ExitStack() as closing:
        for part in (context.store.folder, context.store, context.response_cache, audit):
            closing.callback(part.close)
        closing.callback(audit.add, SERVICE, "end")
        for part in (context.fault, context.cell, context.jobs, context.retention):
            closing.callback(part.close)


def openapi_document() -> str:
    """Return the OpenAPI description of the API, as committed in `service/openapi.json`."""
    return format_json(create_app(load_config()).openapi())


if __name__ == "__main__":
    sys.stdout.write(openapi_document())
