"""Points of a view for drawing: few enough for a browser, with all that stands above the table."""

import numpy as np
from numpy.typing import NDArray

from cell.devices import View
from cell.recording.header import RecordingHeader
from recognition.preprocessing.target_cloud import deproject

MAX_POINTS = 10_000
"""Maximum number of points. Eight views then have at most 80,000."""
MIN_HEIGHT_M = 0.002
"""Height above the table from which a point counts as standing above it. Noise of the table is below it."""


def view_points(view: View, header: RecordingHeader) -> NDArray[np.float64]:
    """Return the points (N, 3) of a view in the workspace, at most `MAX_POINTS`, metres, base frame.

    Points above the table come first and take up to three quarters of the number. The rest is an even sample of the
    others.

    Args:
        view: The view.
        header: Header of its recording, with the workspace and the height of the table.
    """
    rows, columns = np.nonzero(view.depth)
    points = deproject(view, rows, columns)
    if header.workspace_m is not None:
        box = np.array(header.workspace_m)
        points = points[np.all((points >= box[:, 0]) & (points <= box[:, 1]), axis=1)]
    is_above = points[:, 2] > header.table_z_m + MIN_HEIGHT_M
    above = _sample(points[is_above], 3 * MAX_POINTS // 4)
    return np.concatenate([above, _sample(points[~is_above], MAX_POINTS - len(above))])


def _sample(points: NDArray[np.float64], count: int) -> NDArray[np.float64]:
    """Return at most `count` of the points, evenly spread over their order."""
    if len(points) <= count:
        return points
    return points[np.linspace(0, len(points) - 1, count).astype(np.intp)]
