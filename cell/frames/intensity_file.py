"""Intensity images in files: 8-bit grey PNG, aligned with the depth images."""

import warnings
from io import BytesIO
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cell.frames.errors import FramesError

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
    from PIL import Image, UnidentifiedImageError

    try:
        if path.stat().st_size > MAX_FILE_BYTES:
            raise FramesError(f"{path} has more than {MAX_FILE_BYTES >> 20} MiB, too much for one intensity image")
        content = path.read_bytes()
    except FileNotFoundError as error:
        raise FramesError(f"{path} is missing: each depth image needs an intensity image of its name") from error
    except OSError as error:
        raise FramesError(f"{path} cannot be read: {error.strerror or error}") from error
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", Image.DecompressionBombWarning)
            image = Image.open(BytesIO(content), formats=["PNG"])
        if image.mode != "L":
            raise FramesError(f"{path} has pixels of the kind {image.mode}: save it as an 8-bit grey PNG")
        image.verify()  # the checksums; the image must then be opened again
        return np.asarray(Image.open(BytesIO(content), formats=["PNG"]), dtype=np.uint8)
    except (Image.DecompressionBombWarning, Image.DecompressionBombError) as error:
        raise FramesError(f"{path} has too many pixels for an intensity image") from error
    except UnidentifiedImageError as error:
        raise FramesError(f"{path} is not a PNG image, though its name says so: save it as an 8-bit PNG") from error
    except (OSError, SyntaxError) as error:
        raise FramesError(f"{path} is damaged or cut off: copy it again") from error
