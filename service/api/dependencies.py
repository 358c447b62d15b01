"""What the routes work with, made when the service starts."""

from dataclasses import dataclass
from typing import Annotated

from anyio import CapacityLimiter
from fastapi import Depends, Path, Query, Request

from cell.control.cell import Cell
from service.api.image_cache import Pictures
from service.api.response_cache import Reading
from service.config.loader import ServiceConfig
from service.events.stream_slots import StreamSlots
from service.jobs.manager import Jobs
from service.problems.problem_error import ProblemError
from service.states import ID_PATTERN
from service.storage.disk_space import require_space
from service.storage.fault_memory import FaultMemory
from service.storage.idempotency_keys import IdempotencyKeys
from service.storage.retention import Retention
from service.storage.rows import RecordingRow, ScanRow
from service.storage.store import Store


@dataclass(frozen=True)
class Context:
    """One running service."""

    config: ServiceConfig
    store: Store
    cell: Cell
    jobs: Jobs
    parsing: CapacityLimiter
    """Uploads are parsed one after the other: each may take much memory."""
    uploads: CapacityLimiter
    """Few are under way at a time: each takes space until it is parsed."""
    planning: CapacityLimiter
    """Viewpoints are planned one after the other: each takes the interpreter for seconds, and a stop needs it too."""
    stopping: CapacityLimiter
    """The threads of stops and cancels. Those of all other requests may all be waiting for a robot that does not
    answer, and a stop would wait for them."""
    pictures: Pictures
    """That are made when somebody looks at them."""
    keys: IdempotencyKeys
    retention: Retention
    streams: StreamSlots
    """Of those who follow events."""
    reading: Reading
    """Of what is asked for most."""
    fault: FaultMemory

    def require_space(self, coming_bytes: int = 0) -> None:
        """Lets pass what takes space in the data folder. Raises ProblemError, `storage-full`; may block."""
        require_space(self.store.folder.root, self.config.limits.min_free_bytes, coming_bytes)


async def _context(request: Request) -> Context:
    return request.app.state.context


Service = Annotated[Context, Depends(_context)]


def _require_space(service: Service) -> None:
    service.require_space()


SPACE = Depends(_require_space)
"""Of an operation that takes space in the data folder: refused with 507 when there is too little."""

Id = Annotated[str, Path(pattern=ID_PATTERN)]


def find_scan(id: Id, service: Service) -> ScanRow:  # noqa: A002 (the path's own name)
    """The scan of this id; asks the database.

    Raises:
        ProblemError: `scan-not-found`.
    """
    scan = service.store.scan(id)
    if scan is None:
        raise ProblemError("scan-not-found", f"there is no scan {id}; GET /api/scans lists them")
    return scan


def _recording(id: Id, service: Service) -> RecordingRow:  # noqa: A002 (the path's own name)
    recording = service.store.recording(id)
    if recording is None:
        raise ProblemError("recording-not-found", f"there is no recording {id}; GET /api/recordings lists them")
    return recording


Scan = Annotated[ScanRow, Depends(find_scan)]
"""The scan that the address names, or a problem 404."""
Recording = Annotated[RecordingRow, Depends(_recording)]
"""The recording that the address names, or a problem 404."""

Limit = Annotated[int, Query(ge=1, le=500, description="At most so many")]
Before = Annotated[str | None, Query(pattern=ID_PATTERN, description="Only those made before this one")]
ViewCount = Annotated[int | None, Query(ge=2, le=32, description="How many viewpoints; the cell's number unless given")]
