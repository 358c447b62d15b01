"""Heights of the pixels of a depth image above the table, and the slopes of their lines of sight."""

import numpy as np
from numpy.typing import NDArray

from recognition.preprocessing.target_cloud import AlignedView


def heights_above_table(aligned: AlignedView, stride: int) -> NDArray[np.float32]:
    """Return the height (H, W) of every `stride`-th pixel above the table, metres; 0 where nothing is measured.

    Args:
        aligned: View aligned to the table plane.
        stride: Step between the pixels, along rows and columns.
    """
    view = aligned.view
    depth = view.depth[::stride, ::stride]
    heights = slopes(aligned, stride) * np.float32(view.depth_unit_m) * depth
    heights += np.float32(aligned.T_base_camera[2, 3] - aligned.scene.table_z_m)
    return np.where(depth > 0, heights, np.float32(0))


def slopes(aligned: AlignedView, stride: int) -> NDArray[np.float32]:
    """Return the rise (H, W) of the line of sight of every `stride`-th pixel per metre of depth.

    Args:
        aligned: View aligned to the table plane.
        stride: Step between the pixels, along rows and columns.
    """
    view = aligned.view
    rows, columns = (np.arange(0, n, stride) for n in view.depth.shape)
    a, b, c = aligned.T_base_camera[2, :3] @ np.linalg.inv(view.K)
    return np.add.outer((b * rows + c).astype(np.float32), (a * columns).astype(np.float32))
