"""A fault of the cell is restored after a restart until a person acknowledges it."""

import sqlite3
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest

from cell.config.arm_config import SimulatedArm
from cell.config.cell_config import CellSettings
from cell.control.cell import Cell
from cell.control.status import CellStatus
from service.storage.database import Database
from service.storage.fault_store import FaultStore
from tests.service.conftest import wait_until


@pytest.fixture
def database(tmp_path: Path) -> Iterator[Database]:
    with closing(Database(tmp_path / "pointchain.sqlite3")) as database:
        yield database


def stored(database: Database) -> list[tuple[str, str]]:
    """Return slug and reason of the stored faults."""
    return database.all(lambda row: (row["slug"], row["reason"]), "SELECT slug, reason FROM cell_fault")


def after_restart(database: Database) -> CellStatus:
    """Return the status of a new cell that uses the database."""
    cell = Cell(CellSettings(arm=SimulatedArm()))
    with closing(cell), closing(FaultStore(database, cell)):
        return cell.status


def test_a_fault_is_restored_after_a_restart(database: Database) -> None:
    cell = Cell(CellSettings(arm=SimulatedArm()))
    with closing(cell):
        reported: list[str] = []
        store = FaultStore(database, cell, reported.append)
        cell.restore_fault("robot-lost", "look at the cell")
        cell.close()  # closing is no acknowledgement
        store.close()
        assert reported == ["robot-lost"]
        assert stored(database) == [("robot-lost", "look at the cell")]
    status = after_restart(database)
    assert (status.state, status.slug, status.reason) == ("fault", "robot-lost", "look at the cell")
    assert stored(database) == [("robot-lost", "look at the cell")]


def test_an_acknowledged_fault_is_not_restored(database: Database) -> None:
    cell = Cell(CellSettings(arm=SimulatedArm()))
    with closing(cell), closing(FaultStore(database, cell)):
        cell.restore_fault("robot-lost", "look at the cell")
        wait_until(lambda: stored(database) != [])
        cell._status.change(state="not_ready", slug="not-connected", reason="acknowledged")
        wait_until(lambda: stored(database) == [])
    assert after_restart(database).state == "not_ready"


def test_a_locked_database_delays_no_change_and_is_written_later(database: Database, tmp_path: Path) -> None:
    cell = Cell(CellSettings(arm=SimulatedArm()))
    with closing(cell), closing(FaultStore(database, cell)):
        with closing(sqlite3.connect(tmp_path / "pointchain.sqlite3", isolation_level=None)) as other:
            other.execute("BEGIN IMMEDIATE")
            cell.restore_fault(
                "protective-stop", "look at the cell"
            )  # returns at once, although this test holds the lock of the database
            assert stored(database) == []
            other.execute("ROLLBACK")
        wait_until(lambda: stored(database) == [("protective-stop", "look at the cell")])
