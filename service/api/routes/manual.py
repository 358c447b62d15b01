"""The manual: static pages that `.ci/docs` builds from `docs/` into `service/manual`."""

from fastapi import APIRouter
from fastapi.responses import RedirectResponse
from starlette.exceptions import HTTPException
from starlette.staticfiles import StaticFiles
from starlette.types import Receive, Scope, Send

from service.problems.problem_error import ProblemError
from service.security.auth.roles import MANUAL
from service.security.middleware.headers import MANUAL_FOLDER

START = "index.html"


class ManualFiles(StaticFiles):
    """The files of the manual. The service also runs where the manual is not built."""

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Send a file.

        Raises:
            ProblemError: `manual-not-built`: The manual is not built.
            HTTPException: 404: No such file exists. 405: The method is neither GET nor HEAD.
        """
        if ".." in scope["path"].split("/"):  # StaticFiles would redirect some of them
            raise HTTPException(404)
        if self.lookup_path(START)[1] is None:
            hint = "run `make setup`, or install a wheel, which contains it"
            raise ProblemError("manual-not-built", f"the manual is not built: {hint}")
        await super().__call__(scope, receive, send)


FILES = ManualFiles(directory=MANUAL_FOLDER, html=True, check_dir=False)
router = APIRouter(include_in_schema=False)


@router.get(MANUAL)
async def manual_start() -> RedirectResponse:
    """Redirect to the manual's first page. Its links are relative, so the address needs the slash."""
    return RedirectResponse(f"{MANUAL}/")
