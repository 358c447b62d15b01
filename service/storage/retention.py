"""Old scans and recordings are removed, where it is configured: by their age, or as long as all together are too large.

What a person has marked to be kept stays, with its recording; so does what is under way, and what ended a moment ago.
Nothing is removed within an hour of the service's start, nor of a moment at which the machine's clock was set: an age
is only believed of a clock that has gone steadily. Nothing here makes room for anything: a scan that finds too little
of it is refused.
"""

import logging
import sqlite3
import threading
from collections.abc import Callable
from datetime import datetime, timedelta

from service import clock as wall_clock
from service.clock import Steadiness, stamp
from service.config.sections import RetentionConfig
from service.storage.removal import oldest_first, remove, tree_bytes
from service.storage.store import Store

log = logging.getLogger(__name__)

EVERY_S = 3600.0
AGAIN_S = 60.0
"""While something is under way, and when the database was locked, it is tried again so much later."""
STEADY_S = 3600.0
"""So long the wall clock must have gone without being set."""
UNTOUCHED = timedelta(hours=1)
"""Whoever asked for a scan has so long to fetch its result, and who has sent a recording to use it."""


def sweep(store: Store, config: RetentionConfig, moment: datetime, may_go_on: Callable[[], bool]) -> bool:
    """Removes what is too old or too much at this moment; asked before each, `may_go_on` tells whether to end early.

    False: it ended early.

    Raises:
        sqlite3.Error, OSError: the store cannot be read, or something cannot be removed.
    """
    age = None if config.max_age_days is None else stamp(moment - timedelta(days=config.max_age_days))
    excess = 0 if config.max_bytes is None else _used(store) - config.max_bytes
    for old in oldest_first(store, stamp(moment - UNTOUCHED)):
        too_old = age is not None and old.at < age
        if not too_old and excess <= 0:
            break
        if not may_go_on():
            return False
        freed = remove(store, old)
        if freed is not None:
            excess -= freed
            log.info("%s %s of %s was removed for its %s", old.kind, old.id, old.at, "age" if too_old else "size")
    return True


def _used(store: Store) -> int:
    """Bytes of all recordings and results."""
    return sum(tree_bytes(store.folder.root / name) for name in ("recordings", "scans"))


class Retention:
    """A thread that looks now and then, while nothing is under way. Close it before the store."""

    def __init__(self, store: Store, config: RetentionConfig, idle: Callable[[], bool]) -> None:
        """`idle` tells whether nothing is under way. Starts the thread if there is anything to do for it."""
        self._store, self._config, self._idle = store, config, idle
        self._ending = threading.Event()
        self._clock = Steadiness()
        self._thread = threading.Thread(target=self._work, name="retention", daemon=True)
        if config.max_age_days is not None or config.max_bytes is not None:
            self._thread.start()

    def close(self) -> None:
        """Ends the thread, behind what it is just removing."""
        self._ending.set()
        if self._thread.ident is not None:
            self._thread.join()

    def _may_go_on(self) -> bool:
        return self._idle() and not self._ending.is_set() and self._clock.seconds() >= STEADY_S

    def _work(self) -> None:
        wait_s = 0.0
        while not self._ending.wait(wait_s):
            wait_s = AGAIN_S
            moment = wall_clock.present()  # before it is asked whether the clock goes well
            try:
                if self._may_go_on() and sweep(self._store, self._config, moment, self._may_go_on):
                    wait_s = EVERY_S
            except (sqlite3.Error, OSError):  # locked, or a file that cannot be removed: nothing depends on it
                log.exception("old scans could not all be removed; it is tried again in %.0f s", wait_s)
