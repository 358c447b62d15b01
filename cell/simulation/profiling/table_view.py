"""What a simulated camera measures on an empty table, seen as another camera saw one."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from cell.camera_profile.measure import PoseImages, TablePose
from cell.config.rendering_options import RenderingOptions
from cell.simulation.rendering.depth_camera import CameraModel, DepthCamera, ImageContent, StillView
from cell.simulation.rendering.stereo_camera import StillPair
from cell.simulation.rendering.stereo_matching import StereoMatching
from cell.simulation.scenes.scenes import StringScene

_RADIUS_M = 0.004
"""Radius of the strings, of which the scene has none."""
_NEXT_POSE_M = 0.05
"""Distance between the places of two poses, so that they see different texture."""
_POSE, _EXPOSURE = 1, 2
"""Streams of a seed."""


@dataclass(frozen=True)
class TableViewing:
    """How the table is seen."""

    rendering: RenderingOptions = field(default_factory=RenderingOptions)
    """Table top and dots. A camera without rendered images has the defaults."""
    seed: int = 0
    """Seed of the device, of the texture and of the noise."""
    images: int = 1
    """Number of images per pose."""
    is_median: bool = False
    """Whether each image is the median of several exposures, as in a recording."""


@dataclass(frozen=True, eq=False)
class TableStills:
    """What all exposures of a table from the given poses share."""

    camera: DepthCamera
    """Camera that sees the table."""
    stills: tuple[StillView | StillPair, ...]
    """What the camera sees, for each pose."""
    viewing: TableViewing
    """How the table is seen."""

    def images(self) -> list[PoseImages]:
        """Return the images of all poses. The same noise is drawn at each call."""
        return [self._images(number, still) for number, still in enumerate(self.stills)]

    def with_matching(self, matching: StereoMatching, noise_factor: float) -> "TableStills":
        """Return the same view of the table with another matching and another noise of the sensors."""
        return replace(self, camera=self.camera.with_matching(matching, noise_factor))

    def _images(self, number: int, still: StillView | StillPair) -> PoseImages:
        """Return the images from one pose."""
        rng = np.random.default_rng([self.viewing.seed, _EXPOSURE, number])
        take = self.camera.combine if self.viewing.is_median else self.camera.expose
        depth = [take(still, rng) for _ in range(self.viewing.images)]
        return PoseImages(np.stack(depth), self.camera.model.depth_unit_m, self.camera.model.K)


def still_tables(model: CameraModel, tables: Sequence[TablePose], viewing: TableViewing) -> TableStills:
    """Return what a simulated camera sees of an empty table.

    Args:
        model: Camera.
        tables: Table in front of the camera, for each pose.
        viewing: How the table is seen.
    """
    scene = StringScene("table", _RADIUS_M, (), ())
    # the bias of a session shifts the whole table, which a measurement of the table alone does not show
    camera = DepthCamera(model, scene, 0.0, viewing.seed, ImageContent(viewing.rendering))
    stills = []
    for number, table in enumerate(tables):
        rng = np.random.default_rng([viewing.seed, _POSE, number])
        stills.append(camera.still_view(camera_above(table, number * _NEXT_POSE_M), rng))
    return TableStills(camera, tuple(stills), viewing)


def view_table(model: CameraModel, tables: Sequence[TablePose], viewing: TableViewing) -> list[PoseImages]:
    """Return the images that a simulated camera takes of an empty table. The arguments are those of `still_tables`."""
    return still_tables(model, tables, viewing).images()


def camera_above(table: TablePose, aside_m: float = 0.0) -> NDArray[np.float64]:
    """Return the camera pose `T_scene_camera` (4, 4) above the table z = 0 of a scene.

    Args:
        table: Table in the camera frame.
        aside_m: Position of the camera along x.
    """
    length = float(np.linalg.norm(table.n))
    up = -table.n / length
    along = np.array([1.0, 0.0, 0.0]) - up[0] * up
    along /= np.linalg.norm(along)
    T = np.eye(4)
    T[:3, :3] = [along, np.cross(up, along), up]
    T[:3, 3] = (aside_m, 0.0, 1 / length)
    return T
