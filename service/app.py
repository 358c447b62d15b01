"""The HTTP service as an ASGI application."""

import json
import sys
from collections.abc import AsyncIterator
from contextlib import ExitStack, asynccontextmanager

from anyio import CapacityLimiter, to_thread
from fastapi import FastAPI
from fastapi_offline import FastAPIOffline

from cell.cell import Cell
from service.body_limit import BodyLimit
from service.config import ServiceConfig, load_config
from service.context import Context
from service.data_folder import DataFolder
from service.jobs import Jobs
from service.problems import install_problem_handlers
from service.routes import calibration, cell, health, recordings, scans
from service.store import Store

API_VERSION = "1"

DESCRIPTION = """Strings, cables and ropes as ordered 3D point chains.

Start a live scan by the cell, or upload a recording and start a scan of it; follow the scan until its state is final,
and fetch its model.
Metres, radians and seconds everywhere. Errors are `application/problem+json` (RFC 9457); decide on their
`type`.
"""


STOPS = 100
"""So many stops and cancels are seen to at the same time; each may wait some seconds for its scan's end."""


def create_app(config: ServiceConfig) -> FastAPI:
    """The application; the data folder and the recognition process are taken when it starts, not here."""

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        app.state.context = context = await to_thread.run_sync(_open, config)
        try:
            yield
        finally:
            # A thread of its own: requests that were given up may still hold all others.
            await to_thread.run_sync(_close, context, limiter=CapacityLimiter(1))

    app = FastAPIOffline(
        title="Pointchain",
        version=API_VERSION,
        description=DESCRIPTION,
        lifespan=lifespan,
        redoc_url=None,
        swagger_ui_parameters={"tryItOutEnabled": True},
    )
    app.add_middleware(
        BodyLimit,
        request_bytes=config.limits.request_bytes,
        upload_bytes=config.limits.upload_bytes,
        upload_path=recordings.PATH,
    )
    install_problem_handlers(app)
    for router in (cell.router, calibration.router, recordings.router, scans.router, health.router):
        app.include_router(router)
    return app


def _open(config: ServiceConfig) -> Context:
    with ExitStack() as if_it_fails:
        folder = DataFolder(config.data_dir)
        if_it_fails.callback(folder.close)
        store = Store(folder)
        if_it_fails.callback(store.close)
        own = Cell(config.cell)
        if_it_fails.callback(own.close)
        jobs = Jobs(store, own, config.limits.recognition_s, config.gripper.value)
        if_it_fails.pop_all()
    return Context(config, store, own, jobs, parsing=CapacityLimiter(1), stopping=CapacityLimiter(STOPS))


def _close(context: Context) -> None:
    """Closes all, the last to be opened first; what one of them raises keeps none of the others open."""
    with ExitStack() as opened:
        for part in (context.store.folder, context.store, context.cell, context.jobs):
            opened.callback(part.close)


def openapi_document() -> str:
    """The description of the API, as committed in openapi.json."""
    return json.dumps(create_app(load_config()).openapi(), indent=2) + "\n"


if __name__ == "__main__":
    sys.stdout.write(openapi_document())
