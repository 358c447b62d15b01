"""Whether the service lives, and whether it can do a scan."""

from fastapi import APIRouter

from service.context import Service
from service.problems import ProblemError, problem_responses
from service.schemas import Health, Readiness

router = APIRouter(tags=["health"])


@router.get("/healthz", responses=problem_responses())
async def healthz() -> Health:
    """The event loop turns."""
    return Health()


@router.get("/readyz", responses=problem_responses(503))
def readyz(service: Service) -> Readiness:
    """The store answers and the recognition process waits for work, or is at it."""
    service.store.check()
    if service.jobs.not_ready is not None:
        raise ProblemError(503, "not-ready", service.jobs.not_ready, {"Retry-After": "1"})
    return Readiness()
