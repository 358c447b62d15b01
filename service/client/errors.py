"""What can go wrong between a program and the service."""

import httpx

from service.schemas import Problem, ScanResource


class ClientError(Exception):
    """Whatever the client raises of its own."""


class ProblemError(ClientError):
    """The service refused something; `slug` is what programs decide on, as `cell-busy`."""

    def __init__(self, problem: Problem) -> None:
        super().__init__(f"{problem.title}: {problem.detail}")
        self.problem = problem

    @property
    def slug(self) -> str:
        """The problem's type without what all have in common."""
        return self.problem.type.removeprefix("urn:pointchain:")


class ScanFailedError(ClientError):
    """A scan that has no model: `scan` says in which state it is and why."""

    def __init__(self, scan: ScanResource) -> None:
        reason = "" if scan.problem is None else f": {scan.problem.detail}"
        super().__init__(f"scan {scan.id} is {scan.state}{reason}")
        self.scan = scan

    @property
    def slug(self) -> str | None:
        """Why, for programs; None where it has no problem, as one that has not ended."""
        return None if self.scan.problem is None else self.scan.problem.type.removeprefix("urn:pointchain:")


class UnreachableError(ClientError):
    """The service cannot be reached, or does not answer."""


class UnansweredError(UnreachableError):
    """A scan may have been begun: the connection was lost before the answer came.

    `Client.start` with the same wish and this `key` finds it, or begins it if it was not.
    """

    def __init__(self, key: str, reason: Exception) -> None:
        super().__init__(
            f"whether the scan was begun is not known, the connection was lost ({reason}): look at the cell, then ask "
            f"again with key={key!r}"
        )
        self.key = key


def require_success(answer: httpx.Response) -> httpx.Response:
    """The answer, if it is no error.

    Raises:
        ProblemError: it is a problem.
        UnreachableError: it is an error of something else than the service.
    """
    if not answer.is_error:
        return answer
    answer.read()
    if answer.headers.get("content-type", "").startswith("application/problem+json"):
        raise ProblemError(Problem.model_validate(answer.json()))
    raise UnreachableError(f"{answer.url} answered {answer.status_code}, and it does not seem to be the service")
