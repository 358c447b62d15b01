"""Changes of the cell's state as news; they are not kept."""

from dataclasses import asdict, dataclass
from functools import cached_property
from json import dumps
from typing import Any

from cell.control.cell import Cell
from cell.control.status import CellStatus, State
from service.events.hub import EventHub


@dataclass(frozen=True)
class CellEvent:
    """The state that the cell is in, as `GET /api/cell` tells it."""

    state: State
    problem: str | None
    reason: str | None

    @cached_property
    def text(self) -> str:
        """As JSON; made once for all who follow."""
        return dumps(asdict(self))


def cell_event(status: CellStatus) -> CellEvent:
    """What is told of a status."""
    return CellEvent(status.state, None if status.slug is None else f"urn:pointchain:{status.slug}", status.reason)


def publish_changes(cell: Cell, hub: EventHub[Any]) -> None:
    """From now on, those who follow everything are told of each change."""
    last: CellEvent | None = None

    def told(status: CellStatus) -> None:
        nonlocal last
        event = cell_event(status)
        if event != last:  # what else has changed is no news
            last = event
            hub.publish(None, event)

    cell.on_status(told)
