"""Routes of the operator's console: its page and its files."""

from pathlib import Path

from fastapi import APIRouter, Request, Response
from starlette.exceptions import HTTPException
from starlette.staticfiles import StaticFiles

from service.problems.problem_error import ProblemError

BUILT = Path(__file__).parents[2] / "console/built"
router = APIRouter(include_in_schema=False)

# not checked at start, because the service also runs without a built console
FILES = StaticFiles(directory=BUILT, check_dir=False)


@router.api_route("/", methods=["GET", "HEAD"])
async def console_page(request: Request) -> Response:
    """Return the page of the console."""
    try:
        return await FILES.get_response("index.html", request.scope)
    except HTTPException as error:
        hint = "run `make setup`, or install a wheel, which contains it; /docs describes the API"
        raise ProblemError("console-not-built", f"the console is not built: {hint}") from error
