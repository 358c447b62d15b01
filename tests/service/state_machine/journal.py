"""A record of the store's successive states that checks each change against the documented rules."""

import json
import sqlite3
from contextlib import closing
from pathlib import Path
from typing import Any

from service.integrity.recording_check import acknowledged_views, find_lost_views
from service.states import ACTIVE_STATES
from service.storage.data_folder import DATABASE
from service.storage.rows import ViewRow

STARTS = ("queued", "connecting")
ENDS = ("stopping", "failed", "aborted", "interrupted")
NEXT: dict[str, tuple[str, ...]] = {
    "queued": ("processing", *ENDS),
    "connecting": ("preflight", *ENDS),
    "preflight": ("scanning", *ENDS),
    "scanning": ("processing", *ENDS),
    "processing": ("succeeded", "partial", *ENDS),
    "stopping": ("failed", "aborted", "interrupted"),
}
"""The states that may follow each state. A final state has none."""
SCANS = "SELECT id, mode, state, stage, fraction, started_at, ended_at, summary, failure, recording, kept FROM scans"


class Journal:
    """The checked history of one data folder, across restarts of its service."""

    def __init__(self, data: Path) -> None:
        self._data = data
        self.scans: dict[str, dict[str, Any]] = {}
        """Rows of the scans by id, as last read."""
        self._states: dict[str, str] = {}
        """The last state of each scan that an event reported."""
        self._views: dict[tuple[str, int], ViewRow] = {}
        """All acknowledged views, by scan and view."""
        self._newest = 0
        """Id of the last event read."""

    @property
    def active(self) -> list[str]:
        """Ids of the scans that had not ended when last read."""
        return [key for key, scan in self.scans.items() if scan["state"] in ACTIVE_STATES]

    @property
    def ended(self) -> list[str]:
        """Ids of the scans that had ended when last read."""
        return [key for key, scan in self.scans.items() if scan["state"] not in ACTIVE_STATES]

    def update(self, removing: bool = False) -> None:
        """Read the store in one transaction and check all changes. With `removing`, old scans may be missing."""
        with closing(sqlite3.connect(f"file:{self._data / DATABASE}?mode=ro", uri=True)) as db:
            db.row_factory = sqlite3.Row
            db.execute("BEGIN")
            scans = {row["id"]: dict(row) for row in db.execute(SCANS)}
            events = db.execute("SELECT * FROM events WHERE id > ? ORDER BY id", (self._newest,)).fetchall()
            views = [ViewRow(**dict(row)) for row in db.execute("SELECT * FROM views")]
        self._check_scans(scans, removing)
        self._check_events(events, removing)
        for key, scan in scans.items():
            assert self._states[key] == scan["state"], (
                f"scan {key} is {scan['state']}, but {self._states[key]} by its events"
            )
        self.scans = scans
        self._check_views(views)

    def event_ids(self, scan: str) -> list[int]:
        """Return the ids of all events of a scan, in order."""
        with closing(sqlite3.connect(f"file:{self._data / DATABASE}?mode=ro", uri=True)) as db:
            return [row[0] for row in db.execute("SELECT id FROM events WHERE scan = ? ORDER BY id", (scan,))]

    def check_files(self) -> None:
        """Check that every acknowledged view is on the disk, byte for byte."""
        for scan in {view.scan for view in self._views.values()}:
            self._check_file([view for view in self._views.values() if view.scan == scan])

    def _check_scans(self, scans: dict[str, dict[str, Any]], removing: bool) -> None:
        for key, before in self.scans.items():
            now = scans.get(key)
            if now is None:
                assert removing, f"scan {key} is missing"
                assert not before["kept"], f"protected scan {key} was removed"
                del self._states[key]
                self._views = {of: view for of, view in self._views.items() if of[0] != key}
            elif before["state"] not in ACTIVE_STATES:
                same = {name: before[name] for name in before if name != "kept"}
                # On a full disk, a live scan's recording may be added later. After that it must not change.
                if before["recording"] is None:
                    del same["recording"]
                assert same.items() <= now.items(), f"scan {key} changed after its end: from {before} to {now}"
        active = [key for key, scan in scans.items() if scan["state"] in ACTIVE_STATES]
        assert len(active) <= 1, f"more than one scan is active: {active}"

    def _check_events(self, events: list[sqlite3.Row], removing: bool) -> None:
        for event in events:
            assert removing or event["id"] == self._newest + 1, (
                f"missing events between {self._newest} and {event['id']}"
            )
            self._newest = event["id"]
            last, data = self._states.get(event["scan"]), json.loads(event["data"])
            if event["kind"] == "state" and last != data["state"]:
                may_follow = STARTS if last is None else NEXT.get(last, ())
                assert data["state"] in may_follow, f"scan {event['scan']} went from {last} to {data['state']}"
                self._states[event["scan"]] = data["state"]
            else:
                assert last in NEXT, f"scan {event['scan']} is {last}, but has the event {event['kind']} {data}"

    def _check_views(self, views: list[ViewRow]) -> None:
        now = {(view.scan, view.view): view for view in acknowledged_views(views)}
        for key, view in self._views.items():
            assert now.get(key) == view, f"acknowledged view {key} changed from {view} to {now.get(key)}"
        for key in now.keys() - self._views.keys():
            self._check_file([now[key]])
        self._views = now

    def _check_file(self, views: list[ViewRow]) -> None:
        _, lost = find_lost_views(self._data / "recordings" / f"{views[0].scan}.mcap", views)
        assert not lost, f"acknowledged views are not on the disk: {lost}"
