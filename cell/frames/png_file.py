"""Pixels of a PNG file, after a check of its kind and checksums."""

import warnings
from collections.abc import Callable
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from cell.frames.errors import FramesError

if TYPE_CHECKING:
    from PIL.Image import Image as PngImage


def decode_png(
    path: Path, content: bytes, check: Callable[["PngImage"], None], what: str, save_as: str
) -> NDArray[np.generic]:
    """Return the pixels (H, W) or (H, W, channels) of a PNG file.

    Args:
        path: File, for messages.
        content: Its content.
        check: Raises FramesError if the image is of another kind than needed. The pixels are not decoded yet.
        what: Image that is needed, for messages: "a depth image".
        save_as: File that is needed, for messages: "a 16-bit PNG".

    Raises:
        FramesError: The file is no PNG, too large, damaged, or of another kind.
    """
    from PIL import Image, UnidentifiedImageError

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", Image.DecompressionBombWarning)
            image = Image.open(BytesIO(content), formats=["PNG"])
        check(image)
        image.verify()  # the checksums; the image must then be opened again
        return np.asarray(Image.open(BytesIO(content), formats=["PNG"]))
    except (Image.DecompressionBombWarning, Image.DecompressionBombError) as error:
        raise FramesError(f"{path} has too many pixels for {what}") from error
    except UnidentifiedImageError as error:
        raise FramesError(f"{path} is not a PNG image, though its name says so: save it as {save_as}") from error
    except (OSError, SyntaxError) as error:
        raise FramesError(f"{path} is damaged or cut off: copy it again") from error
