"""Routes of the operator's console: its page and its files."""

import mimetypes
import os
from pathlib import Path

from fastapi import APIRouter, Request, Response
from fastapi.responses import FileResponse
from starlette.datastructures import Headers
from starlette.exceptions import HTTPException
from starlette.staticfiles import NotModifiedResponse, StaticFiles
from starlette.types import Scope

from service.problems.problem_error import ProblemError

BUILT = Path(__file__).parents[2] / "console/built"
router = APIRouter(include_in_schema=False)


class CompressedFiles(StaticFiles):
    """Files of a folder. A file with a compressed copy beside it, named `.gz`, is sent compressed if the client can."""

    def file_response(
        self, full_path: str | os.PathLike[str], stat_result: os.stat_result, scope: Scope, status_code: int = 200
    ) -> Response:
        """Return the response with the file, or 304 if the client has it."""
        copy, request = Path(f"{full_path}.gz"), Headers(scope=scope)
        if "gzip" not in request.get("accept-encoding", "") or not copy.is_file():
            response = super().file_response(full_path, stat_result, scope, status_code)
            response.headers["Vary"] = "Accept-Encoding"
            return response
        headers = {"Content-Encoding": "gzip", "Vary": "Accept-Encoding"}
        media_type, _ = mimetypes.guess_type(full_path)
        compressed = FileResponse(copy, status_code, headers, media_type, stat_result=copy.stat())
        if self.is_not_modified(compressed.headers, request):
            return NotModifiedResponse(compressed.headers)
        return compressed


# not checked at start, because the service also runs without a built console
FILES = CompressedFiles(directory=BUILT, check_dir=False)


@router.get("/")
async def console_page(request: Request) -> Response:
    """Return the page of the console."""
    try:
        return await FILES.get_response("index.html", request.scope)
    except HTTPException as error:
        hint = "run `make setup`, or install a wheel, which contains it; /docs describes the API"
        raise ProblemError("console-not-built", f"the console is not built: {hint}") from error
