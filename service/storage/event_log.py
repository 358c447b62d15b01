"""What happened to scans, as rows that are written in one transaction with what they tell of.

Ids rise in the order of the commits, without gaps but for what was removed with its scan, and what is published comes
in that order too.
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

MOST_BEHIND = 1000
"""Who has missed more events of all scans starts anew: those of one scan are fewer by far."""


@dataclass(frozen=True)
class ScanEvent:
    """One change of a scan: what has changed, not the whole of it."""

    id: int
    scan: str
    at: str
    kind: Kind
    data: dict[str, Any]
    """Of `state`: state, stage, fraction, failure, summary, as in the scan's row; of `progress`: stage, fraction; of
    `view`: index, state, reason."""

    @property
    def final(self) -> bool:
        """The scan has ended; it has no later events."""
        return self.kind == "state" and self.data["state"] not in ACTIVE_STATES


class UnknownEventError(ValueError):
    """No such event was ever told where it is asked for."""


@dataclass(frozen=True)
class Present:
    """A scan at one moment."""

    scan: ScanRow
    views: list[ViewRow]
    newest: int
    """Id of the last event that is in it; 0: there is none."""

    @property
    def over(self) -> bool:
        """The scan has ended."""
        return self.scan.state not in ACTIVE_STATES


@dataclass(frozen=True)
class Behind:
    """What has happened since an event."""

    events: list[ScanEvent]
    """The oldest first."""
    over: bool
    """The scan has ended, and these are the last."""


class Change:
    """One transaction that changes scans, and the events that belong to it."""

    def __init__(self, db: sqlite3.Connection) -> None:
        self.db = db
        self.events: list[ScanEvent] = []

    def state(self, scan_id: str) -> None:
        """Notes the state that the scan's row has by now, and all that comes with it."""
        columns = "state, stage, fraction, failure, summary"
        row = dict(self.db.execute(f"SELECT {columns} FROM scans WHERE id = ?", (scan_id,)).fetchone())
        for name in ("failure", "summary"):
            row[name] = None if row[name] is None else json.loads(row[name])
        self._note(scan_id, "state", row)

    def progress(self, scan_id: str) -> None:
        """Notes how far the scan's row says it has come."""
        row = self.db.execute("SELECT stage, fraction FROM scans WHERE id = ?", (scan_id,)).fetchone()
        self._note(scan_id, "progress", dict(row))

    def view(self, scan_id: str, index: int, state: str, reason: str | None) -> None:
        """Notes what has become of a viewpoint."""
        self._note(scan_id, "view", {"index": index, "state": state, "reason": reason})

    def _note(self, scan_id: str, kind: Kind, data: dict[str, Any]) -> None:
        at = now()
        sql = "INSERT INTO events (scan, at, kind, data) VALUES (?, ?, ?, ?)"
        event_id = self.db.execute(sql, (scan_id, at, kind, json.dumps(data, allow_nan=False))).lastrowid
        assert event_id is not None
        self.events.append(ScanEvent(event_id, scan_id, at, kind, data))


class ScanEvents:
    """The events of all scans, and the way to those who follow them. Safe to use from any thread."""

    def __init__(self, database: Database) -> None:
        self._database = database
        self.hub: EventHub[ScanEvent | CellEvent] = EventHub()
        """By scan; the cell's are for those who follow all."""
        self._in_order = threading.Lock()
        """Held from before the commit until its events are published. Only who has the database's write lock asks for
        it, so nobody waits here while he waits for the database."""

    @contextmanager
    def changing(self) -> Iterator[Change]:
        """A transaction; once it is on the disk, those who follow are told of its events."""
        with ExitStack() as published:
            with self._database.transaction() as db:
                published.enter_context(self._in_order)
                change = Change(db)
                yield change
            for event in change.events:
                self.hub.publish(event.scan, event)

    def present(self, scan_id: str) -> Present | None:
        """The scan and its newest event, of the same moment; None: there is no such scan."""
        with self._database.snapshot() as db:
            row = db.execute("SELECT * FROM scans WHERE id = ?", (scan_id,)).fetchone()
            if row is None:
                return None
            views = db.execute("SELECT * FROM views WHERE scan = ? ORDER BY view", (scan_id,)).fetchall()
            (newest,) = db.execute("SELECT max(id) FROM events WHERE scan = ?", (scan_id,)).fetchone()
            return Present(to_scan(row), [ViewRow(**dict(view)) for view in views], newest or 0)

    def behind(self, scan_id: str, last: int) -> Behind | None:
        """What has happened to the scan since the event `last` of it; None: that was removed, nobody can tell.

        Raises:
            UnknownEventError: there never was such an event, or it is another scan's.
        """
        with self._database.snapshot() as db:
            if last > _newest(db):
                raise UnknownEventError(f"there is no event {last} yet")
            told = db.execute("SELECT scan FROM events WHERE id = ?", (last,)).fetchone()
            if told is not None and told["scan"] != scan_id:
                raise UnknownEventError(f"event {last} is not of this scan")
            if told is None and last > 0:
                return None
            scan = db.execute("SELECT state FROM scans WHERE id = ?", (scan_id,)).fetchone()
            if scan is None:
                return None
            rows = db.execute("SELECT * FROM events WHERE scan = ? AND id > ? ORDER BY id", (scan_id, last)).fetchall()
        return Behind([_event(row) for row in rows], scan["state"] not in ACTIVE_STATES)

    def all_behind(self, last: int) -> list[ScanEvent] | None:
        """What has happened to all scans since the event `last`; None: some are gone or it is too many, start anew.

        Raises:
            UnknownEventError: there never was such an event.
        """
        with self._database.snapshot() as db:
            newest = _newest(db)
            if last > newest:
                raise UnknownEventError(f"there is no event {last} yet")
            sql = "SELECT * FROM events WHERE id > ? ORDER BY id LIMIT ?"
            rows = db.execute(sql, (last, MOST_BEHIND)).fetchall()
        # There is one for each number, unless it was removed.
        return [_event(row) for row in rows] if len(rows) == newest - last else None

    def newest(self) -> int:
        """Id of the newest event of all; 0: there never was one."""
        with self._database.snapshot() as db:
            return _newest(db)


def _newest(db: sqlite3.Connection) -> int:
    """Also when it was removed since."""
    row = db.execute("SELECT seq FROM sqlite_sequence WHERE name = 'events'").fetchone()
    return 0 if row is None else row["seq"]


def _event(row: sqlite3.Row) -> ScanEvent:
    return ScanEvent(**dict(row) | {"data": json.loads(row["data"])})
