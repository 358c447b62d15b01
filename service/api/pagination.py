"""Lists: their filters, and how they go on."""

import re
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from typing import Annotated, Any, Literal, TypeVar
from urllib.parse import urlencode

from fastapi import Depends, Query, Request
from pydantic import AfterValidator, AwareDatetime, BeforeValidator

from service.states import ID_PATTERN, ScanState
from service.storage.queries import ScanFilter
from service.storage.rows import RecordingRow, ScanRow

RFC_3339 = re.compile(r"\d{4}-\d\d-\d\d[Tt]\d\d:\d\d:\d\d(\.\d{1,9})?([Zz]|[+-]\d\d:\d\d)", re.ASCII)
FORM = "RFC 3339 with a time zone is needed, as 2026-01-31T12:00:00Z; a + must be written %2B"

FIRST = datetime.min.replace(tzinfo=UTC)
LAST = datetime.max.replace(tzinfo=UTC) - timedelta(seconds=1)
"""There is room behind it, for it may be rounded up."""

R = TypeVar("R", ScanRow, RecordingRow)


def _rfc_3339(value: Any) -> Any:
    if isinstance(value, str) and not RFC_3339.fullmatch(value):
        raise ValueError(FORM)
    return value


def _in_utc(moment: datetime) -> datetime:
    """A zone can put a moment before the first or behind the last that there is; nothing was accepted out there."""
    try:
        return min(moment.astimezone(UTC), LAST)
    except OverflowError:
        return FIRST if moment.year == FIRST.year else LAST


Moment = Annotated[AwareDatetime, BeforeValidator(_rfc_3339), AfterValidator(_in_utc)]


async def _filter(
    state: Annotated[Sequence[ScanState], Query(description="In this state; more than one may be given")] = (),
    mode: Annotated[Literal["replay", "live"] | None, Query(description="From a recording, or by the cell")] = None,
    recording: Annotated[str | None, Query(pattern=ID_PATTERN, description="Of this recording")] = None,
    source: Annotated[str | None, Query(pattern=ID_PATTERN, description="Done again from this scan")] = None,
    kept: Annotated[bool | None, Query(description="Marked to be kept, or not")] = None,
    created_after: Annotated[Moment | None, Query(description="Accepted later than this")] = None,
    created_before: Annotated[Moment | None, Query(description="Accepted earlier than this")] = None,
) -> ScanFilter:
    return ScanFilter(tuple(state), mode, recording, source, kept, created_after, created_before)


Filter = Annotated[ScanFilter, Depends(_filter)]
"""Which scans the request wants listed."""


def page(found: Sequence[R], limit: int, request: Request) -> tuple[Sequence[R], str | None]:
    """Of one row more than asked for, those asked for; and where the list goes on: the request's own address, behind
    the last of them. None: there is no more."""
    rows = found[:limit]
    if len(found) <= limit:
        return rows, None
    query = [(name, value) for name, value in request.query_params.multi_items() if name != "before"]
    return rows, f"{request.url.path}?{urlencode([*query, ('before', rows[-1].id)])}"
