"""The current state for `/metrics`, read from memory at each scrape. No device and no database is queried.

The sizes of files are the one exception: they are read from the disk once a minute at most.
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

SIZES_MAX_AGE_S = 60.0
"""Age at which the sizes of files are read again."""


class StateMetrics(Collector):
    """Metrics of the cell, the recognition process, the event streams and the disk."""

    def __init__(
        self, cell: Cell, folder: DataFolder, recognition_starts: Callable[[], int], streams: Callable[[], int]
    ) -> None:
        """Create the collector.

        Args:
            cell: The cell.
            folder: The data folder.
            recognition_starts: Returns the number of recognition processes that were started.
            streams: Returns the number of open event streams.
        """
        self._cell, self._folder = cell, folder
        self._recognition_starts, self._streams = recognition_starts, streams
        self._sizes = StoreSizes(folder.root)

    def collect(self) -> Iterator[Metric]:
        """Yield the metrics of a scrape."""
        yield from self._cell_metrics()
        restarts = max(0, self._recognition_starts() - 1)
        yield CounterMetricFamily(
            "pointchain_recognition_restarts", "Recognition processes started after the first", value=restarts
        )
        yield GaugeMetricFamily("pointchain_event_streams_open", "Open event streams", value=self._streams())
        yield GaugeMetricFamily(
            "pointchain_data_free_bytes",
            "Free space on the data folder's disk",
            value=shutil.disk_usage(self._folder.root).free,
        )
        store = GaugeMetricFamily(
            "pointchain_store_bytes", "Size of the stored files, at most one minute old", labels=("kind",)
        )
        for kind, size in self._sizes.latest().items():
            store.add_metric((kind,), size)
        yield store

    def _cell_metrics(self) -> Iterator[Metric]:
        status = self._cell.status
        yield _state_gauge(
            "pointchain_cell_state", "State of the cell: 1 for the current state", get_args(State), status.state
        )
        arm = status.arm_state
        yield _state_gauge(
            "pointchain_robot_mode",
            "Last reported mode of the robot: 1 for that mode",
            get_args(RobotMode),
            None if arm is None else arm.robot_mode,
        )
        yield _state_gauge(
            "pointchain_robot_safety_mode",
            "Last reported mode of the robot's safety system: 1 for that mode",
            get_args(SafetyMode),
            None if arm is None else arm.safety_mode,
        )
        if arm is not None:
            yield GaugeMetricFamily(
                "pointchain_arm_moving", "1 while a move is running or a joint turns", value=int(arm.moving)
            )
            age_s = time.monotonic() - arm.read_s + arm.age_s
            yield GaugeMetricFamily(
                "pointchain_arm_state_age_seconds", "Age of the arm's last reported state", value=age_s
            )
        if status.hand_eye is not None and status.hand_eye.created is not None:
            age = clock.utc_now() - status.hand_eye.created
            yield GaugeMetricFamily(
                "pointchain_calibration_age_seconds",
                "Age of the calibration that was last used",
                value=age.total_seconds(),
            )


class StoreSizes:
    """Sizes of the parts of the data folder. Safe to use from any thread."""

    def __init__(self, root: Path) -> None:
        self._root = root
        self._lock = threading.Lock()
        self._measured: tuple[float, dict[str, int]] | None = None
        """Monotonic seconds of the last measurement, and its sizes."""

    def latest(self) -> dict[str, int]:
        """Return the bytes of each kind. A file that appears or disappears meanwhile may or may not be included."""
        with self._lock:
            if self._measured is None or time.monotonic() - self._measured[0] >= SIZES_MAX_AGE_S:
                database = sum(_size(path) for path in self._root.glob("pointchain.sqlite3*"))
                recordings, results = _folder_size(self._root / "recordings"), _folder_size(self._root / "scans")
                sizes = {"database": database, "recordings": recordings, "results": results}
                self._measured = time.monotonic(), sizes
            return self._measured[1]


def _state_gauge(name: str, documentation: str, states: tuple[str, ...], current: str | None) -> GaugeMetricFamily:
    label = name.removeprefix("pointchain_").rpartition("_")[2]
    gauge = GaugeMetricFamily(name, documentation, labels=(label,))
    for state in states:
        gauge.add_metric((state,), float(state == current))
    return gauge


def _folder_size(folder: Path) -> int:
    return sum(_size(Path(parent, name)) for parent, _, names in os.walk(folder) for name in names)


def _size(path: Path) -> int:
    try:
        return path.lstat().st_size
    except OSError:  # the file was removed after it was listed
        return 0
