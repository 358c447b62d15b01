"""Client of the service, for programs that plan with its models. Import it with `from service.client import Client`."""

from service.client.client import Client
from service.client.errors import (
    ClientError,
    NotEndedError,
    ProblemError,
    ScanFailedError,
    UnansweredError,
    UnreachableError,
)
from service.client.progress import ScanProgress

__all__ = [
    "Client",
    "ClientError",
    "NotEndedError",
    "ProblemError",
    "ScanFailedError",
    "ScanProgress",
    "UnansweredError",
    "UnreachableError",
]
