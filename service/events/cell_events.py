"""Events of the cell's state. They are not stored."""

from dataclasses import asdict, dataclass
from functools import cached_property
from json import dumps
from typing import Any

from cell.control.cell import Cell
from cell.control.status import CellStatus, State
from service.events.hub import EventHub


@dataclass(frozen=True)
class CellEvent:
    """State of the cell, with problem and reason, as in `GET /api/cell`."""

    state: State
    problem: str | None
    reason: str | None

    @cached_property
    def text(self) -> str:
        """The event as JSON, encoded once for all subscribers."""
        return dumps(asdict(self))


def cell_event(status: CellStatus) -> CellEvent:
    """Return the event of a cell status."""
    return CellEvent(status.state, None if status.slug is None else f"urn:pointchain:{status.slug}", status.reason)


def publish_changes(cell: Cell, hub: EventHub[Any]) -> None:
    """Publish each further change of the cell's state to the subscribers of all topics."""
    last: CellEvent | None = None

    def publish(status: CellStatus) -> None:
        nonlocal last
        event = cell_event(status)
        if event != last:  # other members of the status may have changed
            last = event
            hub.publish(None, event)

    cell.on_status(publish)
