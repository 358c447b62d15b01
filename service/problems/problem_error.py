"""The error that the HTTP layer raises to refuse a request, with a slug of the table of problem types."""

from starlette.exceptions import HTTPException

from service.errors import Parameter
from service.problems.document import status_of


class ProblemError(HTTPException):
    """The HTTP layer refuses a request. The layers below it raise `service.errors.ServiceError`.

    It is an HTTPException, because FastAPI passes on no other error while it reads a body.

    Attributes:
        slug: Type of the problem.
        parameters: The values that the detail contains, by name. A translation of the detail uses them.
    """

    def __init__(self, slug: str, detail: str, headers: dict[str, str] | None = None, **parameters: Parameter) -> None:
        super().__init__(status_of(slug), detail, headers)
        self.slug, self.parameters = slug, parameters
