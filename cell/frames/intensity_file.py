"""Intensity images in files: 8-bit grey PNG, aligned with the depth images."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from cell.frames.errors import FramesError
from cell.frames.png_file import decode_png

if TYPE_CHECKING:
    from PIL.Image import Image as PngImage

MAX_FILE_BYTES = 16 << 20
"""Largest size of a file. An image of the largest size without compression has 4 MiB."""


def read_intensities(folder: Path, names: list[str], shape: tuple[int, int]) -> list[NDArray[np.uint8]]:
    """Return the intensity images (H, W) of a folder, in the order of the depth images.

    Args:
        folder: Folder with a PNG file for each depth image.
        names: Names of the depth images without their endings.
        shape: Height and width of the depth images.

    Raises:
        FramesError: There is no such folder, or an image is missing, damaged, or of another kind or size.
    """
    if not folder.is_dir():
        raise FramesError(f"{folder} is not a folder: name the folder that holds the intensity images")
    images = []
    for name in names:
        path = folder / f"{name}.png"
        image = _read_grey(path)
        if image.shape != shape:
            raise FramesError(
                f"{path} has {image.shape[1]}x{image.shape[0]} pixels, the depth images have {shape[1]}x{shape[0]}: "
                "intensity images must be aligned with the depth pixel for pixel"
            )
        images.append(image)
    return images


def _read_grey(path: Path) -> NDArray[np.uint8]:
    """Return the grey levels (H, W) of a PNG file after a check of its kind and checksums."""
    try:
        if path.stat().st_size > MAX_FILE_BYTES:
            raise FramesError(f"{path} has more than {MAX_FILE_BYTES >> 20} MiB, too much for one intensity image")
        content = path.read_bytes()
    except FileNotFoundError as error:
        raise FramesError(f"{path} is missing: each depth image needs an intensity image of its name") from error
    except OSError as error:
        raise FramesError(f"{path} cannot be read: {error.strerror or error}") from error

    def check(image: "PngImage") -> None:
        if image.mode != "L":
            raise FramesError(f"{path} has pixels of the kind {image.mode}: save it as an 8-bit grey PNG")

    return decode_png(path, content, check, "an intensity image", "an 8-bit PNG").astype(np.uint8)
