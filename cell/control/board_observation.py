"""What one picture of the board tells, before anything is solved: for whoever watches a calibration."""

from dataclasses import dataclass

import numpy as np

from calibration.dataset.setup import Setup
from calibration.observations import BoardView

ACROSS, DOWN = 8, 5
"""Parts of the picture, for the coverage."""


@dataclass(frozen=True)
class BoardSeen:
    """The board in a picture."""

    corners: int
    possible: int
    """So many the board has."""
    rms_px: float | None
    """How far its corners are from where this board would have them by the pose that fits this picture alone best, each
    coordinate; None: no pose fits."""
    cells: tuple[int, ...]
    """Which of the picture's parts (8 x 5) have a corner: row by row, 0 is the first of the upper row."""


def board_seen(view: BoardView, setup: Setup) -> BoardSeen:
    """Of a view that shows the board."""
    from calibration.pose_estimation.board_pose import estimate_board_poses
    from calibration.pose_estimation.projection import stack_corners

    rms_px = float(estimate_board_poses(stack_corners(setup.observations((view,)))).rms_px[0])
    parts = (view.pixels / setup.image_size * (ACROSS, DOWN)).astype(np.int64).clip(0, (ACROSS - 1, DOWN - 1))
    return BoardSeen(
        corners=len(view.ids),
        possible=len(setup.board.points),
        rms_px=rms_px if np.isfinite(rms_px) else None,
        cells=tuple(np.unique(parts @ (1, ACROSS)).tolist()),
    )
