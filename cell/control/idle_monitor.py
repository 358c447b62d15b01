"""Monitoring of an idle arm, so that its faults are noticed too."""

import logging
import threading

from cell.control.equipment import Equipment
from cell.control.status import SharedStatus
from cell.errors import CellError

log = logging.getLogger(__name__)

PERIOD_S = 0.5
"""Period of the check."""


class IdleMonitor:
    """A thread that checks the arm of a ready cell and keeps the arm's watchdog alive."""

    def __init__(self, equipment: Equipment, status: SharedStatus, lock: threading.Lock) -> None:
        """Start the thread.

        Args:
            equipment: Devices of the cell.
            status: Status of the cell.
            lock: Lock of the equipment. While another thread holds it, no check is needed.
        """
        self._equipment, self._status, self._lock = equipment, status, lock
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._run, name="cell-monitor", daemon=True)
        self._thread.start()

    def end(self) -> None:
        """End the thread and wait for its end."""
        self._ending.set()
        self._thread.join()

    def _run(self) -> None:
        while not self._ending.wait(PERIOD_S):
            if self._status.now.state != "ready" or not self._lock.acquire(blocking=False):
                continue
            try:
                if self._status.now.state == "ready":
                    self._equipment.arm.check_ready()
            except CellError as error:
                self._status.set_outcome(error)
            except Exception as error:  # the monitor must go on
                log.exception("the idle arm could not be checked")
                self._status.set_outcome(error)
            finally:
                self._lock.release()
