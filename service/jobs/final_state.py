"""The final row of a scan or calibration whose storing has failed: it is written as soon as it can be."""

import logging
import sqlite3
from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import Any

from service.jobs.job import Running

log = logging.getLogger(__name__)

AGAIN_S = 1.0
"""How long until it is tried again; whoever wants to begin something, or to close, comes in between."""


def write_last(
    running: Running[Any], leaving: Callable[[Running[Any]], AbstractContextManager[None]], write: Callable[[], None]
) -> None:
    """Writes the row by `write`, within `leaving`, however often it takes: a database that is held or a disk that is
    full takes it some time, and nobody would be told of the end otherwise. Meanwhile nothing else begins.

    Given up when the service is ending, and when the database says that waiting is no use: the next start mends the
    row.
    """
    told = False
    while True:
        try:
            with leaving(running):
                write()
            return
        except sqlite3.OperationalError:  # held, full, or the disk fails
            if not told:
                log.exception("how %s has ended cannot be written; it is tried until it can", running.words)
                told = True
        except sqlite3.Error:
            log.exception("how %s has ended cannot be written", running.words)
            break
        if running.given_up.wait(AGAIN_S):
            break
    with leaving(running):
        pass
