"""Errors of the service, each with a slug that names its type, and the reason why a job has no result.

Nothing here knows HTTP. `service.problems` has the title, the status and the advice of each slug.
"""

from dataclasses import dataclass
from typing import Literal

from calibration.geometry.transforms import NotRigidError
from cell.devices import InvalidViewError
from cell.recording.errors import RecordingError
from recognition.errors import RecognitionError

INPUT_ERRORS = (RecordingError, RecognitionError, NotRigidError, InvalidViewError)
"""Errors of what a client sent or a camera recorded. Each class has a `slug`; the client can act on it."""

JobKind = Literal["scan", "calibration", "verification"]

Parameter = str | int | float
"""Value in a message: an id, a name, a state, a count, or a number in SI units."""


@dataclass(frozen=True)
class Failure:
    """Why a job ended without a result."""

    slug: str
    """Type of the problem, for programs."""
    message: str
    """What happened and what to do, for people."""


@dataclass(frozen=True)
class JobReference:
    """A job, as an error refers to it."""

    kind: JobKind
    id: str


class ServiceError(Exception):
    """The service refuses a request.

    Attributes:
        slug: Type of the problem, for programs.
        retry_after_s: Time after which the same request may succeed; None: it depends on other things.
        job: The job that is in the way, if any.
        parameters: The values that the message contains, by name. A translation of the message uses them.
    """

    def __init__(
        self,
        slug: str,
        message: str,
        *,
        retry_after_s: float | None = None,
        job: JobReference | None = None,
        **parameters: Parameter,
    ) -> None:
        super().__init__(message)
        self.slug, self.retry_after_s, self.job, self.parameters = slug, retry_after_s, job, parameters
