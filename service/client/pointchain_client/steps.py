"""Steps that a call of the client consists of, such as sending a request or a pause.

A call is a *flow*: a generator that yields steps and returns the result. It decides everything and waits for nothing.
`Client` and `AsyncClient` carry out the steps, each in its own way. `httpx2.Auth.auth_flow` has the same form.
"""

from collections.abc import Generator, Mapping
from dataclasses import dataclass, field
from typing import Any, BinaryIO, Generic, TypeAlias, TypeVar, cast

import httpx2

from pointchain_client.progress import ScanProgress

T = TypeVar("T")


@dataclass(frozen=True)
class Request:
    """Send a request. The flow receives the `httpx2.Response`, with its content."""

    method: str
    """HTTP method."""
    path: str
    """Path of the resource."""
    params: Mapping[str, Any] = field(default_factory=dict)
    """Parameters of the query."""
    json: Any = None
    """JSON value of the body. None: no such body."""
    headers: Mapping[str, str] = field(default_factory=dict)
    """Further headers."""
    timeout: httpx2.Timeout | None = None
    """Timeout of the request. None: that of the client."""
    upload: BinaryIO | None = None
    """Open binary file that is the body. None: no such body."""
    is_stop: bool = False
    """Whether to send it by the connection that is kept for a stop."""


@dataclass(frozen=True)
class OpenEvents:
    """Open a stream of events. The flow receives the `httpx2.Response`, with its content unless it is a success."""

    path: str
    """Path of the stream."""
    headers: Mapping[str, str]
    """Further headers."""
    timeout: httpx2.Timeout
    """Timeout of connecting, and of the wait for the next bytes."""


@dataclass(frozen=True)
class NextEvent:
    """Wait for the next event of the open stream. The flow receives it, or None at the end of the stream."""


@dataclass(frozen=True)
class CloseEvents:
    """Close the open stream, if there is one."""


@dataclass(frozen=True)
class Pause:
    """Wait for some time."""

    seconds: float
    """Duration, seconds."""


Step: TypeAlias = Request | OpenEvents | NextEvent | CloseEvents | Pause | ScanProgress
"""One step. A `ScanProgress` is reported to the caller."""
Flow: TypeAlias = Generator[Step, Any, T]
"""Steps of a call. A `httpx2.RequestError` of a step is raised in the flow at this step."""


class RunningFlow(Generic[T]):
    """A flow that a client is carrying out."""

    def __init__(self, flow: Flow[T]) -> None:
        """Begin a flow.

        Args:
            flow: The flow. It has not begun.
        """
        self._flow = flow
        self._result: T | None = None
        self.step: Step | None = None
        """The step to carry out. None: the flow has ended."""
        self.resume(None)

    def resume(self, value: Any) -> None:
        """Continue with the result of the step."""
        try:
            self.step = self._flow.send(value)
        except StopIteration as end:
            self.step, self._result = None, end.value

    def fail(self, error: Exception) -> None:
        """Continue with the error of the step."""
        try:
            self.step = self._flow.throw(error)
        except StopIteration as end:
            self.step, self._result = None, end.value

    @property
    def result(self) -> T:
        """Result of the flow, which has ended."""
        return cast(T, self._result)
