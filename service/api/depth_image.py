"""A view's depth image for people: coloured by height above the table, for by distance a string can hardly be seen."""

import math

import numpy as np

from cell.devices import View
from cell.recording.header import RecordingHeader

LARGEST = 480
"""Pixels across and down, at most: it is looked at beside seven others."""
FEWEST = 16
"""Of a workspace that is in fewer pixels across or down, nothing can be made out: the whole image is drawn."""
LOW_M, HIGH_M = -0.003, 0.027
"""Heights above the table that the colours begin and end with: what is lower or higher has those of the ends."""
NEAREST_M = 1e-3
"""What is nearer to the camera than this, or behind it, is nowhere in the picture."""


def draw_depth(view: View, header: RecordingHeader) -> bytes:
    """A PNG: low is blue, high is yellow, what was not measured is black. Cut to where the workspace is, if that is
    known and in sight."""
    import cv2

    rows, columns = _in_sight(view, header)
    step = max(1, math.ceil(max(rows.stop - rows.start, columns.stop - columns.start) / LARGEST))
    v = np.arange(rows.start, rows.stop, step)[:, None]
    u = np.arange(columns.start, columns.stop, step)
    z_m = view.depth[v, u] * view.depth_unit_m
    (fx, _, cx), (_, fy, cy), _ = view.K
    T = view.T_base_camera
    height_m = z_m * (T[2, 0] * (u - cx) / fx + T[2, 1] * (v - cy) / fy + T[2, 2]) + T[2, 3] - header.table_z_m
    share = np.clip((height_m - LOW_M) / (HIGH_M - LOW_M), 0.0, 1.0)
    picture = cv2.applyColorMap((share * 255).astype(np.uint8), cv2.COLORMAP_CIVIDIS)
    picture[z_m == 0] = 0
    return cv2.imencode(".png", picture)[1].tobytes()


def _in_sight(view: View, header: RecordingHeader) -> tuple[slice, slice]:
    """Rows and columns of the image in which the workspace may be; all where it is not known, or not in front of the
    camera as a whole, or not in the image."""
    height, width = view.depth.shape
    whole = slice(0, height), slice(0, width)
    if header.workspace_m is None:
        return whole
    corners = np.stack(np.meshgrid(*header.workspace_m, indexing="ij"), axis=-1).reshape(-1, 3)
    T = view.T_base_camera
    seen = (corners - T[:3, 3]) @ T[:3, :3]
    if (seen[:, 2] < NEAREST_M).any():
        return whole
    pixels = seen @ view.K.T
    pixels = pixels[:, :2] / pixels[:, 2:]
    u0, v0 = np.floor(pixels.min(axis=0)).clip(0, (width, height)).astype(int).tolist()
    u1, v1 = np.ceil(pixels.max(axis=0)).clip(0, (width, height)).astype(int).tolist()
    if u1 - u0 < FEWEST or v1 - v0 < FEWEST:
        return whole
    return slice(v0, v1), slice(u0, u1)
