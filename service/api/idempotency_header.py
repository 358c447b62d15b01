"""The caller and the idempotency key of a request that starts a scan."""

import hashlib
import json
from dataclasses import dataclass
from typing import Annotated

from fastapi import Depends, Header, Request
from pydantic import BaseModel

from service.api.schemas.scans import ReprocessRequest
from service.jobs.submission import Requester
from service.problems.problem_error import ProblemError
from service.security.auth.caller import caller_of
from service.storage.idempotency_keys import Key

MAX_KEY_LENGTH = 255
"""Maximum length of a key, in characters."""

# only for the OpenAPI document; `check_key` enforces it, because an invalid key has a problem type of its own
KEY_SCHEMA = {"minLength": 1, "maxLength": MAX_KEY_LENGTH, "pattern": "^[!-~]([ -~]*[!-~])?$"}
KEY_DESCRIPTION = (
    "Makes it safe to repeat the request. With one token, the same key and body never start a second scan. After a "
    "stop of the arm, they start no scan that was first requested before the stop."
)


def body_hash(path: str, body: BaseModel) -> str:
    """Return the SHA-256 of a request, from its path and the values of its body.

    The order of members, spaces, the notation of numbers, and defaults that are written out make no difference. In a
    `ReprocessRequest`, an absent member means the value of the first scan, so there it does make a difference.
    """
    is_reprocess = isinstance(body, ReprocessRequest)
    document = [path, body.model_dump(mode="json", exclude_unset=is_reprocess, exclude_defaults=not is_reprocess)]
    return hashlib.sha256(json.dumps(document, sort_keys=True, allow_nan=False).encode()).hexdigest()


def check_key(key: str) -> str:
    """Return the key if it is valid.

    Raises:
        ProblemError: `idempotency-key`: The key is not 1 to 255 characters of printable ASCII.
    """
    if not (1 <= len(key) <= MAX_KEY_LENGTH and key.isascii() and key.isprintable()):
        raise ProblemError(
            "idempotency-key", f"the Idempotency-Key must be 1 to {MAX_KEY_LENGTH} characters of printable ASCII"
        )
    return key


@dataclass(frozen=True)
class ScanCaller:
    """Path, caller and key of a request that may start a scan."""

    path: str
    """Path of the request."""
    caller: str
    """Name of the caller, to whom the key belongs."""
    name: str | None
    """Name of the caller's token, or None if the caller needs no token."""
    key: str | None
    """Idempotency key, or None if the request has none."""

    def requester(self, body: BaseModel) -> Requester:
        """Return the requester of a scan, whose key is bound to the body of the request."""
        key = None if self.key is None else Key(self.caller, self.key, body_hash(self.path, body))
        return Requester(self.name, key)


async def _scan_caller(
    request: Request,
    idempotency_key: Annotated[
        str | None, Header(alias="Idempotency-Key", description=KEY_DESCRIPTION, json_schema_extra=KEY_SCHEMA)
    ] = None,
) -> ScanCaller:
    if len(request.headers.getlist("idempotency-key")) > 1:
        raise ProblemError("idempotency-key", "there is more than one Idempotency-Key; send one")
    key = None if idempotency_key is None else check_key(idempotency_key)
    caller = caller_of(request)
    return ScanCaller(request.url.path, caller.name, caller.token_name, key)


RequesterDependency = Annotated[ScanCaller, Depends(_scan_caller)]
"""The caller and key of the request, or the problem `idempotency-key` if the key is not valid."""
