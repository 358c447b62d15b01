"""Removal of old scans and recordings, if configured: by age, or while all together exceed a size.

Scans that a person marked to be kept stay, with their recordings. So do running scans and scans that ended within the
last hour. Nothing is removed within an hour after the service started or the clock of the machine was set: an age is
valid only if the clock ran steadily. Retention does not make room for a scan; a scan without enough space is refused.
"""

import logging
import sqlite3
import threading
from collections.abc import Callable
from datetime import datetime, timedelta

from service import clock as wall_clock
from service.clock import ClockStepDetector, format_utc
from service.config.sections import RetentionConfig
from service.storage.removal import oldest_first, remove, tree_bytes
from service.storage.store import Store

log = logging.getLogger(__name__)

INTERVAL_S = 3600.0
"""Interval of sweeps."""
RETRY_S = 60.0
"""Interval of retries while a job runs, and after the database was locked."""
STEADY_S = 3600.0
"""How long the wall clock must have run without being set."""
MIN_AGE = timedelta(hours=1)
"""Minimum age of what is removed: clients have this time to fetch a result or to use an uploaded recording."""


def sweep(store: Store, config: RetentionConfig, moment: datetime, may_continue: Callable[[], bool]) -> bool:
    """Remove scans and recordings that are too old, and the oldest ones while all exceed the size limit.

    Args:
        store: The store.
        config: Limits of age and size.
        moment: Present time.
        may_continue: Called before each removal; False ends the sweep early.

    Returns:
        False if the sweep ended early.

    Raises:
        sqlite3.Error, OSError: The store cannot be read, or a file cannot be removed.
    """
    age = None if config.max_age_days is None else format_utc(moment - timedelta(days=config.max_age_days))
    excess = 0 if config.max_bytes is None else _used(store) - config.max_bytes
    for candidate in oldest_first(store, format_utc(moment - MIN_AGE)):
        too_old = age is not None and candidate.at < age
        if not too_old and excess <= 0:
            break
        if not may_continue():
            return False
        freed = remove(store, candidate.kind, candidate.id)
        if freed is not None:
            excess -= freed
            log.info(
                "%s %s of %s was removed for its %s",
                candidate.kind,
                candidate.id,
                candidate.at,
                "age" if too_old else "size",
            )
    return True


def _used(store: Store) -> int:
    """Return the size of all recordings and results, bytes."""
    return sum(tree_bytes(store.folder.root / name) for name in ("recordings", "scans"))


class Retention:
    """A thread that removes old scans while no job runs. Close it before the store."""

    def __init__(self, store: Store, config: RetentionConfig, idle: Callable[[], bool]) -> None:
        """Start the thread, if retention is configured. `idle` returns whether no job runs."""
        self._store, self._config, self._idle = store, config, idle
        self._ending = threading.Event()
        self._clock = ClockStepDetector()
        self._thread = threading.Thread(target=self._work, name="retention", daemon=True)
        if config.max_age_days is not None or config.max_bytes is not None:
            self._thread.start()

    def close(self) -> None:
        """End the thread after its present removal."""
        self._ending.set()
        if self._thread.ident is not None:
            self._thread.join()

    def _may_continue(self) -> bool:
        return self._idle() and not self._ending.is_set() and self._clock.seconds_since_step() >= STEADY_S

    def _work(self) -> None:
        wait_s = 0.0
        while not self._ending.wait(wait_s):
            wait_s = RETRY_S
            moment = wall_clock.utc_now()  # before the check of the clock
            try:
                if self._may_continue() and sweep(self._store, self._config, moment, self._may_continue):
                    wait_s = INTERVAL_S
            except (sqlite3.Error, OSError):  # a locked database, or a file that cannot be removed
                log.exception("not all old scans could be removed; the next attempt is in %.0f s", wait_s)
