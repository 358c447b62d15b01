"""Depth images in files: 16-bit grey PNG, or NPY of integers or floats. Each is checked before it is used."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from cell.frames.errors import FramesError
from cell.frames.png_file import decode_png
from cell.recording.limits import DEFAULT_LIMITS

if TYPE_CHECKING:
    from PIL.Image import Image as PngImage

PICTURE_MODES = {
    "1": "has 1 bit a pixel, as pictures for viewing have",
    "L": "has 8 bits a pixel, as pictures for viewing have",
    "LA": "is grey with alpha",
    "P": "is colour (palette)",
    "RGB": "is colour (RGB)",
    "RGBA": "is colour (RGBA)",
}
"""What a PNG of each Pillow mode is that cannot be a depth image."""
MAX_FILE_BYTES = 64 << 20
"""A depth image of the largest size in float64 has 32 MiB."""
MAX_COUNT = int(np.iinfo(np.uint16).max)
"""Largest depth count of a recording."""
FINE_UNITS_M = (1e-5, 2e-5, 5e-5, 1e-4)
"""Depth units of recordings made from floats, finest first. The last reaches 6.55 m."""


def read_depth(path: Path) -> NDArray[np.generic]:
    """Return the values (H, W) in the file as they are: uint16 of a PNG, integers or floats of an NPY file.

    Raises:
        FramesError: The file cannot be read, is damaged, or holds no depth.
    """
    try:
        if path.stat().st_size > MAX_FILE_BYTES:
            raise FramesError(f"{path} has more than {MAX_FILE_BYTES >> 20} MiB, too much for one depth image")
        content = path.read_bytes()
    except OSError as error:
        raise FramesError(f"{path} cannot be read: {error.strerror or error}") from error
    values = _from_png(path, content) if path.suffix.lower() == ".png" else _from_npy(path)
    if values.dtype.kind in "if":
        with np.errstate(invalid="ignore"):
            negative = int(np.count_nonzero(values < 0))  # pyright: ignore[reportOperatorIssue]
        if negative:
            raise FramesError(
                f"{path} has {negative} negative depths: depth is a distance along the optical axis; mark pixels "
                "without depth by 0 or NaN"
            )
    if not measured(values).any():
        raise FramesError(f"{path} has no pixel with a depth (all are 0 or NaN): remove the image and its pose")
    return values


def measured(values: NDArray[np.generic]) -> NDArray[np.bool_]:
    """Return which pixels (H, W) have a depth: 0, NaN and infinity mean that none was measured."""
    with np.errstate(invalid="ignore"):
        return np.isfinite(values) & np.greater(values, 0)  # pyright: ignore[reportArgumentType, reportCallIssue]


def fine_unit(largest_m: float) -> float:
    """Return the finest depth unit whose 16 bits reach `largest_m`, or the coarsest of `FINE_UNITS_M`."""
    return next((unit for unit in FINE_UNITS_M if largest_m / unit <= MAX_COUNT), FINE_UNITS_M[-1])


def to_counts(values: NDArray[np.generic], unit_m: float, recording_unit_m: float) -> NDArray[np.uint16]:
    """Return depth (H, W) in counts of `recording_unit_m`; 0 where there is no depth, or one beyond 65535 counts.

    Args:
        values: (H, W), in units of `unit_m`.
        unit_m: Metres per unit of `values`.
        recording_unit_m: Metres per count of the result. Equal units leave integers as they are.
    """
    known = measured(values)
    if values.dtype.kind in "iu" and unit_m == recording_unit_m:
        return np.where(known & np.less_equal(values, MAX_COUNT), values, 0).astype(np.uint16)  # pyright: ignore[reportArgumentType, reportCallIssue]
    metres = np.where(known, values, 0).astype(np.float64) * unit_m
    counts = np.rint(metres / recording_unit_m)
    return np.where(counts <= MAX_COUNT, counts, 0).astype(np.uint16)


def _from_png(path: Path, content: bytes) -> NDArray[np.generic]:
    """Decode a PNG after a check of its kind, size and checksums."""

    def check(image: "PngImage") -> None:
        if image.mode != "I;16":
            kind = PICTURE_MODES.get(image.mode, f"has pixels of the kind {image.mode}")
            raise FramesError(f"{path} {kind}, not depth: move it out of the folder, or save depth as 16-bit grey PNG")
        _check_size(path, image.width, image.height)

    return decode_png(path, content, check, "a depth image", "a 16-bit PNG").astype(np.uint16)


def _from_npy(path: Path) -> NDArray[np.generic]:
    """Load an NPY file after a check of its type and shape."""
    try:
        stored = np.load(path, mmap_mode="r", allow_pickle=False)
    except (ValueError, OSError, EOFError) as error:
        raise FramesError(f"{path} is not an NPY array of numbers, or it is damaged: {error}") from error
    if not isinstance(stored, np.ndarray) or stored.dtype.kind not in "iuf":
        kind = stored.dtype if isinstance(stored, np.ndarray) else "several arrays"
        raise FramesError(f"{path} holds {kind}; integers or floats are needed")
    if stored.ndim != 2:
        colour = ", as a colour image has" if stored.ndim == 3 and stored.shape[2] in (3, 4) else ""
        raise FramesError(f"{path} has the shape {stored.shape}{colour}; (height, width) is needed")
    if stored.dtype == np.uint8:
        raise FramesError(f"{path} has 8 bits a pixel, as pictures for viewing have; depth needs 16 or more")
    _check_size(path, stored.shape[1], stored.shape[0])
    return np.array(stored)


def _check_size(path: Path, width: int, height: int) -> None:
    if not 0 < width * height <= DEFAULT_LIMITS.image_pixels:
        raise FramesError(f"{path} has {width}x{height} pixels; from 1 to {DEFAULT_LIMITS.image_pixels} are allowed")
