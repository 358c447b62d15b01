"""JSON document of a height map. Metres, base frame."""

from typing import Literal

from service.api.schemas.base import ApiModel


class HeightMapDocument(ApiModel):
    """Height of the table and of all that lies on it, in square cells, as the median of the views."""

    frame: Literal["base"]
    """The frame of all positions and heights: the base of the robot."""
    x_m: float
    """Position of the first edge of the first cell along x."""
    y_m: float
    """The same along y."""
    cell_m: float
    """Edge length of the cells. Cell (i, j) begins at x_m + i cell_m, y_m + j cell_m."""
    table_z_m: float
    """Height of the table plane."""
    min_object_height_m: float
    """Height above the table from which an object is told from the noise of the table."""
    z_m: list[list[float | None]]
    """Height of the surface in each cell, as z_m[i][j]. Null where no view measured it."""
