"""Routes of liveness and readiness."""

from typing import Any

from fastapi import APIRouter, Response
from fastapi.responses import JSONResponse

from service.api.dependencies import Service
from service.api.problem_responses import problem_responses
from service.api.readiness import failed_checks, readiness
from service.api.schemas.health import Health, Readiness
from service.problems.document import MEDIA_TYPE, problem_document

router = APIRouter(tags=["health"])


@router.get("/healthz", responses=problem_responses())
async def healthz() -> Health:
    """Answer 200 while the event loop runs. Nothing else is checked or waited for."""
    return Health()


@router.get("/readyz", response_model=Readiness, responses=problem_responses("not-ready"))
def readyz(service: Service) -> Any:
    """Answer 200 if the service can run a scan, otherwise 503 with the checks that failed.

    The service is ready if the database accepts changes, recognition is ready or at work, the disk has space, the
    service is not stopping, and its file of tokens can be read. The state of the cell is reported but does not count;
    see `GET /api/cell`.
    """
    checks = readiness(service)
    failed = failed_checks(checks)
    return Readiness(checks=checks) if not failed else _not_ready("; ".join(failed), checks.model_dump())


def _not_ready(detail: str, checks: dict[str, Any]) -> Response:
    problem = problem_document("not-ready", detail, "/readyz", checks=checks)
    return JSONResponse(problem, problem["status"], headers={"Retry-After": "1"}, media_type=MEDIA_TYPE)
