"""From the folder form to observations: finds the board in each image."""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from calibration.dataset.atomic_write import read_in_folder
from calibration.dataset.folder import FolderContent, FolderView
from calibration.dataset.setup import Setup
from calibration.errors import BoardDetectionError, CalibrationFolderError
from calibration.observations import BoardView, Observations
from calibration.pose_estimation.corner_disambiguation import make_numbering_consistent
from calibration.target.detection import BoardSighting, detect_board

__all__ = ["DetectedViews", "board_view", "detect_views", "make_views_consistent", "read_image"]

LARGEST_IMAGE_BYTES = 128 << 20

Told = Callable[[str, BoardSighting | str], None]
"""Called with each view's name, and what was seen or why nothing was."""


@dataclass(frozen=True, eq=False)
class DetectedViews:
    """What the images of a folder show."""

    observations: Observations
    """To solve from."""
    held_out: Observations
    """To verify by; often without views."""
    unseen: tuple[tuple[str, str], ...]
    """Views that gave nothing, those that the folder left out too: name and reason."""


def detect_views(content: FolderContent, told: Told | None = None) -> DetectedViews:
    """Finds the board in every image, one after the other; an image without one is named and left out.

    Raises:
        BoardDetectionError: it is in none of them, and why not in the first.
    """
    setup, unseen = content.setup, list(content.left_out)
    views: list[BoardView] = []
    certain: list[bool] = []
    first_error: BoardDetectionError | None = None
    for view in content.views:
        try:
            sighting = detect_board(read_image(view.image, setup.image_size), setup.board)
        except (BoardDetectionError, CalibrationFolderError) as error:
            unseen.append((view.name, str(error)))
            if isinstance(error, BoardDetectionError):
                first_error = first_error or type(error)(f"no image shows the board; {view.name}: {error}")
            if told is not None:
                told(view.name, str(error))
            continue
        views.append(board_view(view, sighting))
        certain.append(sighting.numbered)
        if told is not None:
            told(view.name, sighting)
    if not views and first_error is not None:
        raise first_error
    held_out = {view.name for view in content.views if view.held_out}
    return DetectedViews(*make_views_consistent(setup, views, certain, held_out), tuple(unseen))


def make_views_consistent(
    setup: Setup, views: Sequence[BoardView], certain: Sequence[bool], held_out: Collection[str]
) -> tuple[Observations, Observations]:
    """The views to solve from, and those that are `held_out` by name: all numbered from the same corner of the board,
    where its pictures leave open which that is. Which views are `certain` (N,), their `BoardSighting.numbered` says.
    """
    alike = make_numbering_consistent(setup.observations(tuple(views)), certain).views
    return (
        setup.observations(tuple(view for view in alike if view.name not in held_out)),
        setup.observations(tuple(view for view in alike if view.name in held_out)),
    )


def board_view(view: FolderView, sighting: BoardSighting) -> BoardView:
    """What was seen in this view."""
    return BoardView(view.name, view.T_base_flange, sighting.ids, sighting.pixels, sighting.corner_sigma_px)


def read_image(path: Path, size: tuple[int, int]) -> NDArray[np.uint8]:
    """(H, W), or (H, W, 3) in BGR: the pixels as they are in the file, whichever way up it says it was held.

    Raises:
        CalibrationFolderError: it cannot be read, or has another size than `size` (width, height).
    """
    import cv2

    content = read_in_folder(path, LARGEST_IMAGE_BYTES, "put the image back, or take its pose away too")
    try:
        coded = np.frombuffer(content, dtype=np.uint8)
        image = cv2.imdecode(coded, cv2.IMREAD_ANYCOLOR | cv2.IMREAD_IGNORE_ORIENTATION) if content else None
    except cv2.error as error:
        raise CalibrationFolderError(f"{path} is no image: {error.err}") from error
    if image is None:
        raise CalibrationFolderError(f"{path} is no image, or it is damaged: PNG, JPEG, BMP and TIFF are read")
    height, width = image.shape[:2]
    if (width, height) != size:
        raise CalibrationFolderError(
            f"{path} has {width} x {height} pixels, and setup.json says {size[0]} x {size[1]}: the camera's matrix K "
            "holds for one size only"
        )
    return image.astype(np.uint8, copy=False)
