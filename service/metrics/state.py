"""How things stand at the moment, for `/metrics`: read from memory when somebody asks, and from no device or database.

The sizes of files are the one exception; they are looked at once a minute at most.
"""

import os
import shutil
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import get_args

from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.registry import Collector

from cell.control.cell import Cell
from cell.control.status import State
from cell.devices import RobotMode, SafetyMode
from service import clock
from service.storage.data_folder import DataFolder

SIZES_S = 60.0
"""Sizes of files are looked at again after so long."""


class StateMetrics(Collector):
    """The cell, the recognition process, event streams, the disk."""

    def __init__(
        self, cell: Cell, folder: DataFolder, recognition_starts: Callable[[], int], streams: Callable[[], int]
    ) -> None:
        """`recognition_starts`: how many recognition processes were started; `streams`: how many are open."""
        self._cell, self._folder = cell, folder
        self._recognition_starts, self._streams = recognition_starts, streams
        self._sizes = StoreSizes(folder.root)

    def collect(self) -> Iterator[Metric]:
        """Told when a scrape comes."""
        yield from self._of_cell()
        restarts = max(0, self._recognition_starts() - 1)
        yield CounterMetricFamily(
            "pointchain_recognition_restarts", "Recognition processes started after the first", value=restarts
        )
        yield _gauge("pointchain_event_streams_open", "Clients that follow events", self._streams())
        yield _gauge(
            "pointchain_data_free_bytes",
            "Free space on the data folder's disk",
            shutil.disk_usage(self._folder.root).free,
        )
        store = GaugeMetricFamily(
            "pointchain_store_bytes", "Size of what is stored, as of a minute ago at most", labels=("kind",)
        )
        for kind, size in self._sizes.latest().items():
            store.add_metric((kind,), size)
        yield store

    def _of_cell(self) -> Iterator[Metric]:
        status = self._cell.status
        yield _one_of("pointchain_cell_state", "The cell's state: 1 for the present one", get_args(State), status.state)
        arm = status.arm_state
        yield _one_of(
            "pointchain_robot_mode",
            "The robot's mode as last heard: 1 for that one",
            get_args(RobotMode),
            None if arm is None else arm.robot_mode,
        )
        yield _one_of(
            "pointchain_robot_safety_mode",
            "What the robot's safety system told last: 1 for that mode",
            get_args(SafetyMode),
            None if arm is None else arm.safety_mode,
        )
        if arm is not None:
            yield _gauge("pointchain_arm_moving", "1 while a move is under way or a joint turns", int(arm.moving))
            heard_s = time.monotonic() - arm.read_s + arm.age_s
            yield _gauge("pointchain_arm_state_age_seconds", "How long ago the arm was last heard of", heard_s)
        if status.hand_eye is not None and status.hand_eye.created is not None:
            age = clock.present() - status.hand_eye.created
            yield _gauge(
                "pointchain_calibration_age_seconds", "Age of the calibration that was last used", age.total_seconds()
            )


class StoreSizes:
    """How many bytes the data folder's parts have. Safe to use from any thread."""

    def __init__(self, root: Path) -> None:
        self._root = root
        self._lock = threading.Lock()
        self._seen: tuple[float, dict[str, int]] | None = None

    def latest(self) -> dict[str, int]:
        """Bytes by kind; files that come and go meanwhile may count or not."""
        with self._lock:
            if self._seen is None or time.monotonic() - self._seen[0] >= SIZES_S:
                database = sum(_size(path) for path in self._root.glob("pointchain.sqlite3*"))
                recordings, results = _size_below(self._root / "recordings"), _size_below(self._root / "scans")
                sizes = {"database": database, "recordings": recordings, "results": results}
                self._seen = time.monotonic(), sizes
            return self._seen[1]


def _gauge(name: str, words: str, value: float) -> GaugeMetricFamily:
    return GaugeMetricFamily(name, words, value=value)


def _one_of(name: str, words: str, possible: tuple[str, ...], present: str | None) -> GaugeMetricFamily:
    label = name.removeprefix("pointchain_").rpartition("_")[2]
    gauge = GaugeMetricFamily(name, words, labels=(label,))
    for value in possible:
        gauge.add_metric((value,), float(value == present))
    return gauge


def _size_below(folder: Path) -> int:
    return sum(_size(Path(parent, name)) for parent, _, names in os.walk(folder) for name in names)


def _size(path: Path) -> int:
    try:
        return path.lstat().st_size
    except OSError:  # gone since it was listed
        return 0
