"""One simulated case: a scene on the table, the camera, and what the recording states wrongly."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from cell.planning.look_at import Bearing
from cell.simulation.offline_scan import SimulatedScan
from cell.simulation.offline_scan import simulate as simulate_scene
from cell.simulation.pose_errors import PoseErrors
from cell.simulation.rendering.depth_camera import CameraModel
from cell.simulation.scenes.scenes import StringScene


class TierError(ValueError):
    """The tier does not exist, the seed is negative, or no scene can be laid for the seed."""

    slug = "tier"


@dataclass(frozen=True, eq=False)
class Case:
    """A scene on the table, the camera, and the errors of the reported poses and table."""

    tier: str
    """Name of the tier."""
    seed: int
    """Seed of the case, and of its scan."""
    scene: StringScene
    """Strings on the table."""
    camera: CameraModel
    """Camera that sees the scene."""
    errors: PoseErrors
    """Errors of the reported poses."""
    views: int = 8
    """Number of views."""
    bearings: tuple[Bearing, ...] | None = None
    """Bearing of each view. None means bearings on two rings."""
    workspace_half_m: float | None = None
    """Half width of the recorded workspace, metres. All views show the whole workspace. None means a wider workspace
    than the strings need, of which the views show the part with the strings."""
    T_base_table: NDArray[np.float64] = field(default_factory=lambda: np.eye(4))
    """True pose (4, 4) of the table, whose top the recording states as z = 0. The scene lies on its top."""


def simulate(case: Case) -> SimulatedScan:
    """Simulate the scan of a case: its views and the truth. The same case gives the same scan."""
    return simulate_scene(
        case.scene,
        case.camera,
        case.seed,
        case.errors,
        case.views,
        case.T_base_table,
        case.bearings,
        case.workspace_half_m,
    )
