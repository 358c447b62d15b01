"""Depth image of a view for people, coloured by height above the table.

Coloured by distance, a string would hardly be visible.
"""

import math

import numpy as np

from cell.devices import View
from cell.recording.header import RecordingHeader
from service.api.images.height_colours import colour_heights

MAX_SIZE_PX = 480
"""Largest width and height of the image, which the console shows beside seven others."""
MIN_CROP_PX = 16
"""Smallest width and height of a crop. A smaller one shows nothing, so the full image is drawn in its place."""
MIN_DEPTH_M = 1e-3
"""Smallest depth that is projected. If a corner of the workspace is nearer or behind, the full image is drawn."""


def draw_depth(view: View, header: RecordingHeader) -> bytes:
    """Return the depth image of a view as a PNG.

    Low is blue, high is yellow, unmeasured is black. The image is cropped to the workspace, if that is known and
    visible.

    Args:
        view: The view.
        header: Header of its recording, with the workspace and the height of the table.
    """
    import cv2

    rows, columns = _workspace_crop(view, header)
    step = max(1, math.ceil(max(rows.stop - rows.start, columns.stop - columns.start) / MAX_SIZE_PX))
    v = np.arange(rows.start, rows.stop, step)[:, None]
    u = np.arange(columns.start, columns.stop, step)
    z_m = view.depth[v, u] * view.depth_unit_m
    (fx, _, cx), (_, fy, cy), _ = view.K
    T = view.T_base_camera
    height_m = z_m * (T[2, 0] * (u - cx) / fx + T[2, 1] * (v - cy) / fy + T[2, 2]) + T[2, 3] - header.table_z_m
    image = colour_heights(height_m)
    image[z_m == 0] = 0
    return cv2.imencode(".png", image)[1].tobytes()


def _workspace_crop(view: View, header: RecordingHeader) -> tuple[slice, slice]:
    """Return the rows and columns of the image that may show the workspace.

    The full image is returned if the workspace is unknown, not wholly in front of the camera, or not in the image.
    """
    height, width = view.depth.shape
    full_image = slice(0, height), slice(0, width)
    if header.workspace_m is None:
        return full_image
    corners = np.stack(np.meshgrid(*header.workspace_m, indexing="ij"), axis=-1).reshape(-1, 3)
    T = view.T_base_camera
    corners_camera = (corners - T[:3, 3]) @ T[:3, :3]
    if (corners_camera[:, 2] < MIN_DEPTH_M).any():
        return full_image
    pixels = corners_camera @ view.K.T
    pixels = pixels[:, :2] / pixels[:, 2:]
    u0, v0 = np.floor(pixels.min(axis=0)).clip(0, (width, height)).astype(int).tolist()
    u1, v1 = np.ceil(pixels.max(axis=0)).clip(0, (width, height)).astype(int).tolist()
    if u1 - u0 < MIN_CROP_PX or v1 - v0 < MIN_CROP_PX:
        return full_image
    return slice(v0, v1), slice(u0, u1)
