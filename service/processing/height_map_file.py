"""The file of a height map in a result, an archive of NumPy arrays."""

import io
from dataclasses import dataclass
from typing import BinaryIO
from zipfile import BadZipFile

import numpy as np

from recognition.preprocessing.height_map import HeightMap

MAX_CELLS = 10_000_000
"""Maximum number of cells. A file with more is damaged."""


class HeightMapError(ValueError):
    """The file of a height map is damaged."""


@dataclass(frozen=True, eq=False)
class StoredHeightMap:
    """A height map with what is needed to interpret it."""

    heights: HeightMap
    """Heights of the cells."""
    table_z_m: float
    """Height of the table plane, metres, base frame."""
    min_object_height_m: float
    """Minimum height above the table of an object that is not noise, metres."""


def to_npz(stored: StoredHeightMap) -> bytes:
    """Return a height map as the content of its file."""
    file, heights = io.BytesIO(), stored.heights
    numbers = (heights.x_m, heights.y_m, heights.cell_m, stored.table_z_m, stored.min_object_height_m)
    # Not compressed: that would take longer than all other files of the result.
    np.savez(file, numbers=np.array(numbers, dtype=np.float64), z_m=heights.z_m.astype(np.float32))
    return file.getvalue()


def read_npz(file: BinaryIO) -> StoredHeightMap:
    """Read the open file of a height map.

    Raises:
        HeightMapError: The file is damaged.
        OSError: The file cannot be read.
    """
    try:
        with np.load(file, allow_pickle=False) as arrays:
            numbers, z_m = arrays["numbers"], arrays["z_m"]
    except (ValueError, KeyError, EOFError, BadZipFile) as error:
        raise HeightMapError("it is not a height map: it is no archive of these arrays") from error
    valid = numbers.shape == (5,) and np.isfinite(numbers).all() and z_m.ndim == 2 and z_m.size <= MAX_CELLS
    if not valid or z_m.dtype != np.float32 or np.isinf(z_m).any() or numbers[2] <= 0:
        raise HeightMapError("it is not a height map: its values are not those of one")
    x_m, y_m, cell_m, table_z_m, min_height_m = numbers.tolist()
    return StoredHeightMap(HeightMap(x_m, y_m, cell_m, z_m), table_z_m, min_height_m)
