"""Client of the service, for programs that plan with its models. Import it with `from pointchain_client import Client`."""

from pointchain_client.client import Client
from pointchain_client.errors import (
    ClientError,
    NotEndedError,
    ProblemError,
    ScanFailedError,
    UnansweredError,
    UnreachableError,
)
from pointchain_client.progress import ScanProgress

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
