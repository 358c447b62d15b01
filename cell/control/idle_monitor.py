"""What happens to an idle arm is noticed too."""

import logging
import threading

from cell.control.equipment import Equipment
from cell.control.status import KeptStatus
from cell.errors import CellError

log = logging.getLogger(__name__)

WATCH_S = 0.5
"""How often an idle arm is looked at."""


class IdleWatch:
    """Looks at the arm of a cell that is ready, and keeps its watchdog quiet, in a thread of its own."""

    def __init__(self, equipment: Equipment, status: KeptStatus, turn: threading.Lock) -> None:
        """It begins at once. `turn` is of using the equipment; while another has it, nobody needs to look."""
        self._equipment, self._status, self._turn = equipment, status, turn
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._run, name="cell-watch", daemon=True)
        self._thread.start()

    def end(self) -> None:
        """Returns when it has ended."""
        self._ending.set()
        self._thread.join()

    def _run(self) -> None:
        while not self._ending.wait(WATCH_S):
            if self._status.now.state != "ready" or not self._turn.acquire(blocking=False):
                continue
            try:
                if self._status.now.state == "ready":
                    self._equipment.arm.check_ready()
            except CellError as error:
                self._status.after(error)
            except Exception as error:  # the watch goes on: nobody else would notice
                log.exception("the idle arm could not be looked at")
                self._status.after(error)
            finally:
                self._turn.release()
