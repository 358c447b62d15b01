"""The operator's console: its page, and the files that the page names."""

from pathlib import Path

from fastapi import APIRouter, Request, Response
from starlette.exceptions import HTTPException
from starlette.staticfiles import StaticFiles

from service.problems.problem_error import ProblemError

BUILT = Path(__file__).parents[2] / "console/built"
router = APIRouter(include_in_schema=False)

# Where nothing is built, the service runs all the same.
FILES = StaticFiles(directory=BUILT, check_dir=False)


@router.api_route("/", methods=["GET", "HEAD"])
async def console_page(request: Request) -> Response:
    """What an operator opens."""
    try:
        return await FILES.get_response("index.html", request.scope)
    except HTTPException as error:
        hint = "run `make setup`, or install a wheel, which has it; /docs describes the calls"
        raise ProblemError("console-not-built", f"the console is not built: {hint}") from error
