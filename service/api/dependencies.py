"""Dependencies of the routes: the parts of the running service, and parameters that several routes share."""

from dataclasses import dataclass
from typing import Annotated

from anyio import CapacityLimiter
from fastapi import Depends, Path, Query, Request

from cell.config.cell_config import ScanViews
from cell.control.cell import Cell
from service.api.images.image_cache import ImageCache
from service.api.response_cache import ResponseCache
from service.config.loader import ServiceConfig
from service.events.stream_slots import StreamSlots
from service.jobs.manager import Jobs
from service.problems.problem_error import ProblemError
from service.processing.reach_finder import ReachFinder
from service.states import ID_PATTERN
from service.storage.disk_space import require_space
from service.storage.fault_store import FaultStore
from service.storage.idempotency_keys import IdempotencyKeys
from service.storage.retention import Retention
from service.storage.rows import RecordingRow, ScanRow
from service.storage.store import Store


@dataclass(frozen=True)
class Context:
    """The parts of one running service, made when it starts."""

    config: ServiceConfig
    store: Store
    cell: Cell
    jobs: Jobs
    parsing: CapacityLimiter
    """Limits the parsing of uploads to one at a time, because each may take much memory."""
    uploads: CapacityLimiter
    """Limits the number of concurrent uploads, because each takes space until it is parsed."""
    planning: CapacityLimiter
    """Limits planning to one at a time, because it holds the interpreter for seconds, and a stop needs it too."""
    stopping: CapacityLimiter
    """Threads of stops and cancels. All other threads may be waiting for a robot that does not answer."""
    image_cache: ImageCache
    """Images that are drawn on request."""
    keys: IdempotencyKeys
    retention: Retention
    streams: StreamSlots
    """Slots of the open event streams."""
    response_cache: ResponseCache
    """The most frequent responses."""
    fault: FaultStore
    reach: ReachFinder
    """Reach of grasps by the cell. Used within the limit of `planning`."""

    def require_space(self, incoming_bytes: int = 0) -> None:
        """Check that the data folder has space for `incoming_bytes` more. May block.

        Raises:
            ServiceError: `storage-full`: The space is less than the configured reserve plus `incoming_bytes`.
        """
        require_space(self.store.folder.root, self.config.limits.min_free_bytes, incoming_bytes)


async def _context(request: Request) -> Context:
    return request.app.state.context


Service = Annotated[Context, Depends(_context)]


def _require_space(service: Service) -> None:
    service.require_space()


REQUIRE_SPACE = Depends(_require_space)
"""Dependency of a route that takes space in the data folder. It answers 507 if there is too little."""

Id = Annotated[str, Path(pattern=ID_PATTERN)]


def find_scan(id: Id, service: Service) -> ScanRow:  # noqa: A002 (the path's own name)
    """Return the scan with this id from the database.

    Raises:
        ProblemError: `scan-not-found`: There is no such scan.
    """
    scan = service.store.scans.get(id)
    if scan is None:
        raise ProblemError("scan-not-found", f"there is no scan {id}; GET /api/scans lists them", scan=id)
    return scan


def _recording(id: Id, service: Service) -> RecordingRow:  # noqa: A002 (the path's own name)
    recording = service.store.recording(id)
    if recording is None:
        raise ProblemError(
            "recording-not-found", f"there is no recording {id}; GET /api/recordings lists them", recording=id
        )
    return recording


Scan = Annotated[ScanRow, Depends(find_scan)]
"""The scan that the path names, or a problem with status 404."""
Recording = Annotated[RecordingRow, Depends(_recording)]
"""The recording that the path names, or a problem with status 404."""

Limit = Annotated[int, Query(ge=1, le=500, description="Maximum number of items in the answer")]
Before = Annotated[str | None, Query(pattern=ID_PATTERN, description="Id of an item; only older items are listed")]
ViewCount = Annotated[
    ScanViews | None, Query(description='Number of viewpoints from 1 to 32, or "auto"; default: as configured')
]
