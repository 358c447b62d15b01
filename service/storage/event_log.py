"""The log of scan events. Each event is written in the same transaction as the change that it reports.

Ids rise in the order of the commits. Gaps occur only where events were removed with their scan. Events are published in
the same order.
"""

import json
import sqlite3
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from typing import Any, Literal

from service.events.cell_events import CellEvent
from service.events.hub import EventHub
from service.states import ACTIVE_STATES
from service.storage.database import Database, now
from service.storage.rows import ScanRow, ViewRow, to_scan

Kind = Literal["state", "progress", "view"]

MAX_MISSED_EVENTS = 1000
"""A client that missed more events of all scans gets the present state instead. One scan has far fewer events."""


@dataclass(frozen=True)
class ScanEvent:
    """One change of a scan."""

    id: int
    scan: str
    at: str
    kind: Kind
    data: dict[str, Any]
    """What changed. `state` has state, stage, fraction, failure and summary, as in the row of the scan; `progress` has
    stage and fraction; `view` has index, state and reason."""

    @property
    def final(self) -> bool:
        """The scan has ended and has no later events."""
        return self.kind == "state" and self.data["state"] not in ACTIVE_STATES


class UnknownEventError(ValueError):
    """There never was such an event, or it belongs to another scan."""


@dataclass(frozen=True)
class ScanSnapshot:
    """A scan, its views and its newest event, at the same time."""

    scan: ScanRow
    views: list[ViewRow]
    newest: int
    """Id of the newest event; 0 if there is none."""

    @property
    def ended(self) -> bool:
        """The scan has ended."""
        return self.scan.state not in ACTIVE_STATES


@dataclass(frozen=True)
class MissedEvents:
    """The events of a scan after a given one."""

    events: list[ScanEvent]
    """Events, the oldest first."""
    ended: bool
    """The scan has ended and these are its last events."""


class Change:
    """One transaction that changes scans, with the events of these changes."""

    def __init__(self, db: sqlite3.Connection) -> None:
        self.db = db
        self.events: list[ScanEvent] = []

    def state(self, scan_id: str) -> None:
        """Add an event with the state of the scan's row."""
        columns = "state, stage, fraction, failure, summary"
        row = dict(self.db.execute(f"SELECT {columns} FROM scans WHERE id = ?", (scan_id,)).fetchone())
        for name in ("failure", "summary"):
            row[name] = None if row[name] is None else json.loads(row[name])
        self._add(scan_id, "state", row)

    def progress(self, scan_id: str) -> None:
        """Add an event with the progress of the scan's row."""
        row = self.db.execute("SELECT stage, fraction FROM scans WHERE id = ?", (scan_id,)).fetchone()
        self._add(scan_id, "progress", dict(row))

    def view(self, scan_id: str, index: int, state: str, reason: str | None) -> None:
        """Add an event with the state of a view."""
        self._add(scan_id, "view", {"index": index, "state": state, "reason": reason})

    def _add(self, scan_id: str, kind: Kind, data: dict[str, Any]) -> None:
        at = now()
        sql = "INSERT INTO events (scan, at, kind, data) VALUES (?, ?, ?, ?)"
        event_id = self.db.execute(sql, (scan_id, at, kind, json.dumps(data, allow_nan=False))).lastrowid
        assert event_id is not None
        self.events.append(ScanEvent(event_id, scan_id, at, kind, data))


class ScanEvents:
    """The events of all scans, and the hub that sends them to followers. Safe to use from any thread."""

    def __init__(self, database: Database) -> None:
        self._database = database
        self.hub: EventHub[ScanEvent | CellEvent] = EventHub()
        """Topics are ids of scans. Events of the cell go to those who follow all scans."""
        self._in_order = threading.Lock()
        """Held from before the commit until the events are published. It is acquired only with the write lock of the
        database, so that it adds no wait for the database."""

    @contextmanager
    def transaction(self) -> Iterator[Change]:
        """Provide a transaction. Its events are published after it is on disk."""
        with ExitStack() as published:
            with self._database.transaction() as db:
                published.enter_context(self._in_order)
                change = Change(db)
                yield change
            for event in change.events:
                self.hub.publish(event.scan, event)

    def snapshot(self, scan_id: str) -> ScanSnapshot | None:
        """Return a scan and its newest event, read at the same time; None if there is no such scan."""
        with self._database.snapshot() as db:
            row = db.execute("SELECT * FROM scans WHERE id = ?", (scan_id,)).fetchone()
            if row is None:
                return None
            views = db.execute("SELECT * FROM views WHERE scan = ? ORDER BY view", (scan_id,)).fetchall()
            (newest,) = db.execute("SELECT max(id) FROM events WHERE scan = ?", (scan_id,)).fetchone()
            return ScanSnapshot(to_scan(row), [ViewRow(**dict(view)) for view in views], newest or 0)

    def since(self, scan_id: str, last: int) -> MissedEvents | None:
        """Return the events of a scan after its event `last`; None if that event was removed.

        Raises:
            UnknownEventError: There never was such an event, or it belongs to another scan.
        """
        with self._database.snapshot() as db:
            if last > _newest(db):
                raise UnknownEventError(f"there is no event {last} yet")
            known = db.execute("SELECT scan FROM events WHERE id = ?", (last,)).fetchone()
            if known is not None and known["scan"] != scan_id:
                raise UnknownEventError(f"event {last} is not of this scan")
            if known is None and last > 0:
                return None
            scan = db.execute("SELECT state FROM scans WHERE id = ?", (scan_id,)).fetchone()
            if scan is None:
                return None
            rows = db.execute("SELECT * FROM events WHERE scan = ? AND id > ? ORDER BY id", (scan_id, last)).fetchall()
        return MissedEvents([_event(row) for row in rows], scan["state"] not in ACTIVE_STATES)

    def all_since(self, last: int) -> list[ScanEvent] | None:
        """Return the events of all scans after the event `last`; None if some were removed or there are too many.

        Raises:
            UnknownEventError: There never was such an event.
        """
        with self._database.snapshot() as db:
            newest = _newest(db)
            if last > newest:
                raise UnknownEventError(f"there is no event {last} yet")
            sql = "SELECT * FROM events WHERE id > ? ORDER BY id LIMIT ?"
            rows = db.execute(sql, (last, MAX_MISSED_EVENTS)).fetchall()
        # Each id has an event, unless it was removed.
        return [_event(row) for row in rows] if len(rows) == newest - last else None

    def newest(self) -> int:
        """Return the id of the newest event of all; 0 if there never was one."""
        with self._database.snapshot() as db:
            return _newest(db)


def _newest(db: sqlite3.Connection) -> int:
    """Return the id of the newest event, even if it was removed since."""
    row = db.execute("SELECT seq FROM sqlite_sequence WHERE name = 'events'").fetchone()
    return 0 if row is None else row["seq"]


def _event(row: sqlite3.Row) -> ScanEvent:
    return ScanEvent(**dict(row) | {"data": json.loads(row["data"])})
