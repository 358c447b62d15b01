"""Filters and pages of lists."""

import re
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from typing import Annotated, Any, Literal, TypeVar
from urllib.parse import urlencode

from fastapi import Depends, Query, Request
from pydantic import AfterValidator, AwareDatetime, BeforeValidator

from service.states import ID_PATTERN, ScanState
from service.storage.rows import RecordingRow, ScanRow
from service.storage.scan_store import ScanFilter

RFC_3339 = re.compile(r"\d{4}-\d\d-\d\d[Tt]\d\d:\d\d:\d\d(\.\d{1,9})?([Zz]|[+-]\d\d:\d\d)", re.ASCII)
DATE_TIME_HINT = "must be RFC 3339 with a time zone, for example 2026-01-31T12:00:00Z; write a + as %2B"

MIN_TIME = datetime.min.replace(tzinfo=UTC)
MAX_TIME = datetime.max.replace(tzinfo=UTC) - timedelta(seconds=1)
"""One second before the last representable time, because it may be rounded up."""

R = TypeVar("R", ScanRow, RecordingRow)


def _rfc_3339(value: Any) -> Any:
    if isinstance(value, str) and not RFC_3339.fullmatch(value):
        raise ValueError(DATE_TIME_HINT)
    return value


def _in_utc(time: datetime) -> datetime:
    """Return the time in UTC, limited to the representable range. No scan was accepted outside that range."""
    try:
        return min(time.astimezone(UTC), MAX_TIME)
    except OverflowError:
        return MIN_TIME if time.year == MIN_TIME.year else MAX_TIME


DateTime = Annotated[AwareDatetime, BeforeValidator(_rfc_3339), AfterValidator(_in_utc)]


async def _filter(
    state: Annotated[Sequence[ScanState], Query(description="In this state; may be given several times")] = (),
    mode: Annotated[
        Literal["replay", "live"] | None, Query(description="From a recording (replay), or by the cell (live)")
    ] = None,
    recording: Annotated[str | None, Query(pattern=ID_PATTERN, description="Of this recording")] = None,
    source: Annotated[str | None, Query(pattern=ID_PATTERN, description="Reprocessed from this scan")] = None,
    kept: Annotated[bool | None, Query(description="Whether the scan is marked to be kept")] = None,
    created_after: Annotated[DateTime | None, Query(description="Accepted after this time")] = None,
    created_before: Annotated[DateTime | None, Query(description="Accepted before this time")] = None,
) -> ScanFilter:
    return ScanFilter(tuple(state), mode, recording, source, kept, created_after, created_before)


Filter = Annotated[ScanFilter, Depends(_filter)]
"""The filters in the request's query."""


def paginate(rows: Sequence[R], limit: int, request: Request) -> tuple[Sequence[R], str | None]:
    """Return the rows of a page, and the address of the next page, or None if there is none.

    Args:
        rows: Rows from the start of the page, up to `limit + 1`. The extra row shows that there is a next page.
        limit: Number of rows in a page.
        request: The request for this page. The next address is its own, continued after the last row.
    """
    listed = rows[:limit]
    if len(rows) <= limit:
        return listed, None
    query = [(name, value) for name, value in request.query_params.multi_items() if name != "before"]
    return listed, f"{request.url.path}?{urlencode([*query, ('before', listed[-1].id)])}"
