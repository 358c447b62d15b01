"""How long a scan is expected to take, by its plan."""

from dataclasses import dataclass
from itertools import accumulate

from cell.config.arm_config import SimulatedArm
from cell.config.cell_config import CellSettings
from cell.planning.viewpoints import ViewpointPlan

VIEW_OVERHEAD_S = 0.12
"""Time of one view apart from motion, waiting and exposures, measured on the simulated cell.

The move starts and comes to rest, and the view is read and written.
"""
RECOGNITION_S = 0.3
"""Time of recognition after the last view."""


@dataclass(frozen=True)
class ExpectedDuration:
    """Expected times after the first move begins, with the speed slider of the pendant at 100 %."""

    to_model_s: float
    """Time until the model is stored."""
    to_home_s: float
    """Time until the arm is home."""
    to_views_s: tuple[float, ...]
    """Time until each view is recorded, in the order of the path."""


def expected_duration(plan: ViewpointPlan, settings: CellSettings, ends_after: int | None = None) -> ExpectedDuration:
    """Return how long a scan takes.

    Args:
        plan: Viewpoints and path.
        settings: Settings with which they were planned.
        ends_after: Number of views after which the scan ends. The arm waits there for the decision. None: all views.
    """
    legs = [leg for leg in plan.legs if leg.view is not None]
    waits = ends_after is not None and ends_after < len(legs)
    legs = legs[:ends_after]
    if not legs:
        return ExpectedDuration(0.0, 0.0, ())
    factor = settings.arm.time_factor if isinstance(settings.arm, SimulatedArm) else 1.0
    camera = settings.camera
    dwell_s = camera.settle_s + camera.exposures / camera.frame_rate + VIEW_OVERHEAD_S
    to_views_s = tuple(accumulate(leg.duration_s / factor + dwell_s for leg in legs))
    checked_s = RECOGNITION_S if waits else 0.0
    to_home_s = to_views_s[-1] + checked_s + legs[-1].home_duration_s / factor
    return ExpectedDuration(to_views_s[-1] + RECOGNITION_S, to_home_s, to_views_s)
