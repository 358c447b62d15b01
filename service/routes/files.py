"""Files as answers."""

from pathlib import Path

from fastapi.responses import FileResponse
from starlette.types import Receive, Scope, Send

from service.problems import ProblemError


def existing(path: Path) -> Path:
    """The path of a file that is there.

    Raises:
        ProblemError: 404 `no-result`, the file is gone.
    """
    if not path.is_file():
        raise ProblemError(404, "no-result", "the file is gone from the data folder")
    return path


class WholeFile(FileResponse):
    """A file that is always sent whole: a Range refused by Starlette would not be answered by a problem."""

    def __init__(self, path: Path, media_type: str, filename: str | None = None) -> None:
        """`filename` is what a browser saves it as; None shows it instead.

        Raises:
            ProblemError: 404 `no-result`, the file is gone.
        """
        super().__init__(existing(path), media_type=media_type, filename=filename, headers={"accept-ranges": "none"})

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Sends the file as if no Range had been asked for."""
        headers = [(name, value) for name, value in scope["headers"] if name.lower() != b"range"]
        await super().__call__({**scope, "headers": headers}, receive, send)
