"""Events of the cell's state. They are not stored."""

from dataclasses import asdict, dataclass
from functools import cached_property
from json import dumps
from typing import Any

from cell.control.cell import Cell
from cell.control.status import CellStatus, State
from cell.errors import RobotLostError
from service.events.hub import EventHub

Q_DIGITS = 4
"""Digits of joint angles in events: 0.1 mrad is more than the noise of an arm at rest."""


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


@dataclass(frozen=True)
class ArmEvent:
    """Joint angles of the arm, for drawing it. They are null while they are unknown."""

    q_rad: tuple[float, ...] | None
    moving: bool | None

    @property
    def text(self) -> str:
        """The event as JSON."""
        return dumps(asdict(self))


def arm_event(status: CellStatus) -> ArmEvent:
    """Return the present posture of the arm. It is unknown if the cell is not connected or the robot is lost."""
    state = status.arm_state
    if state is None or status.state == "not_ready" or status.slug == RobotLostError.slug:
        return ArmEvent(None, None)
    q_rad = tuple(round(angle, Q_DIGITS) for angle in state.q_rad.tolist())
    return ArmEvent(q_rad, None if status.state == "fault" else state.moving)


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
