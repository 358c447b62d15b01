"""Whether the service lives, and whether it can do a scan."""

from typing import Any

from fastapi import APIRouter, Response
from fastapi.responses import JSONResponse

from service.api.dependencies import Service
from service.api.problem_responses import problem_responses
from service.api.readiness import readiness, what_is_not
from service.api.schemas.health import Health, Readiness
from service.problems.document import MEDIA_TYPE, problem_document

router = APIRouter(tags=["health"])


@router.get("/healthz", responses=problem_responses())
async def healthz() -> Health:
    """The event loop turns: an answer is all that this tells. Asks nothing else, and waits for nothing."""
    return Health()


@router.get("/readyz", response_model=Readiness, responses=problem_responses("not-ready"))
def readyz(service: Service) -> Any:
    """Answer 200 if the database accepts changes, recognition is ready or at work, the disk has room, the service is
    not stopping, and its file of tokens can be read. Otherwise answer 503 with the checks that failed. The state of the
    cell is reported but does not count; see `GET /api/cell`."""
    checks = readiness(service)
    wrong = what_is_not(checks)
    return Readiness(checks=checks) if not wrong else _not_ready("; ".join(wrong), checks.model_dump())


def _not_ready(detail: str, checks: dict[str, Any]) -> Response:
    problem = problem_document("not-ready", detail, "/readyz", checks=checks)
    return JSONResponse(problem, problem["status"], headers={"Retry-After": "1"}, media_type=MEDIA_TYPE)
