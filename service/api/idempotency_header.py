"""Who asks for a scan, and with which idempotency key: taken from the request."""

import hashlib
import json
from dataclasses import dataclass
from typing import Annotated

from fastapi import Depends, Header, Request
from pydantic import BaseModel

from service.api.schemas.scans import Reprocess
from service.jobs.new_rows import Asked
from service.problems.problem_error import ProblemError
from service.security.auth.caller import caller_of
from service.storage.idempotency_keys import Key

LONGEST = 255
"""Characters of a key."""

# Told to readers of the description only: the refusal has a type of its own.
KEY_SCHEMA = {"minLength": 1, "maxLength": LONGEST, "pattern": "^[!-~]([ -~]*[!-~])?$"}
KEY_WORDS = (
    "Makes it safe to send the request again: of one token, the same key and body never start a second "
    "scan; nor, once the arm was stopped, one that was first asked for before that"
)


def body_hash(path: str, body: BaseModel) -> str:
    """Return the SHA-256 of a request, from its path and the values of its body.

    The order of members, spaces, the notation of numbers, and defaults that are written out make no difference. In a
    `Reprocess`, an absent member means the value of the first scan, so there it does make a difference.
    """
    again = isinstance(body, Reprocess)
    document = [path, body.model_dump(mode="json", exclude_unset=again, exclude_defaults=not again)]
    return hashlib.sha256(json.dumps(document, sort_keys=True, allow_nan=False).encode()).hexdigest()


def check_key(key: str) -> str:
    """Return the key.

    Raises:
        ProblemError: `idempotency-key`, it is not 1 to 255 characters of printable ASCII.
    """
    if not (1 <= len(key) <= LONGEST and key.isascii() and key.isprintable()):
        raise ProblemError(
            "idempotency-key", f"the Idempotency-Key must be 1 to {LONGEST} characters of printable ASCII"
        )
    return key


@dataclass(frozen=True)
class Asking:
    """A request that may start a scan."""

    path: str
    caller: str
    name: str | None
    """Of the caller's token."""
    key: str | None

    def asked(self, body: BaseModel) -> Asked:
        """The same with what it asks for."""
        key = None if self.key is None else Key(self.caller, self.key, body_hash(self.path, body))
        return Asked(self.name, key)


async def _asking(
    request: Request,
    idempotency_key: Annotated[
        str | None, Header(alias="Idempotency-Key", description=KEY_WORDS, json_schema_extra=KEY_SCHEMA)
    ] = None,
) -> Asking:
    if len(request.headers.getlist("idempotency-key")) > 1:
        raise ProblemError("idempotency-key", "there is more than one Idempotency-Key; send one")
    key = None if idempotency_key is None else check_key(idempotency_key)
    caller = caller_of(request)
    return Asking(request.url.path, caller.name, None if caller.local else caller.name, key)


Asks = Annotated[Asking, Depends(_asking)]
"""Of the request; `idempotency-key` when its key cannot be used."""
