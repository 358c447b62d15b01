"""From depth images to the target point cloud: deprojection, workspace and height threshold (section II.B)."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray


class DepthView(Protocol):
    """What recognition needs of a view; `cell.devices.View` is one."""

    @property
    def index(self) -> int: ...
    @property
    def depth(self) -> NDArray[np.uint16]: ...
    @property
    def depth_unit_m(self) -> float: ...
    @property
    def K(self) -> NDArray[np.float64]: ...
    @property
    def T_base_camera(self) -> NDArray[np.float64]: ...


@dataclass(frozen=True)
class Scene:
    """Where to look."""

    table_z_m: float = 0.0
    """Height of the table plane in the base frame."""
    workspace_m: tuple[tuple[float, float], tuple[float, float], tuple[float, float]] | None = None
    """Box ((x0, x1), (y0, y1), (z0, z1)) in the base frame; points outside are not looked at. None: everywhere."""
