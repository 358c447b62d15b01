"""Plans of scans, whose groundwork is laid while the devices connect."""

import contextlib
import threading

import numpy as np
from numpy.typing import NDArray

from cell.config.cell_config import CellSettings
from cell.config.scan_views import Views
from cell.errors import ViewpointsError
from cell.planning.groundwork import scan_groundwork
from cell.planning.viewpoints import ViewpointPlan, plan_viewpoints


class ScanPlanner:
    """Plan scans of one cell. Every method may be called from any thread."""

    def __init__(self, settings: CellSettings) -> None:
        self._settings = settings
        self._lock = threading.Lock()
        """Held while groundwork is laid, so that a plan waits for it and does not lay it too."""

    def plan(
        self, views: Views | None, T_flange_camera: NDArray[np.float64], q_now_rad: NDArray[np.float64] | None
    ) -> ViewpointPlan:
        """Plan the viewpoints of a scan and the path through them.

        Args:
            views: Number of viewpoints or `auto`, or None for the configured value.
            T_flange_camera: Camera pose on the flange (4, 4).
            q_now_rad: Joint angles (6,) at the start. None means home.

        Raises:
            ViewpointsError: No home posture is free, or no path leads from the start.
        """
        settings = self._settings.for_views(views)
        with self._lock:
            scan_groundwork(settings, T_flange_camera)
        return plan_viewpoints(settings, T_flange_camera, q_now_rad)

    def prepare(self, views: Views | None, T_flange_camera: NDArray[np.float64]) -> None:
        """Lay the groundwork of a plan in a thread, unless it is kept from an earlier plan.

        The arguments are those of `plan`. The process ends after this thread: NumPy aborts a process that ends while
        another thread computes.
        """
        threading.Thread(target=self._prepare, args=(views, T_flange_camera), name="planning").start()

    def _prepare(self, views: Views | None, T_flange_camera: NDArray[np.float64]) -> None:
        with contextlib.suppress(ViewpointsError), self._lock:  # the plan raises the error again
            scan_groundwork(self._settings.for_views(views), T_flange_camera)
