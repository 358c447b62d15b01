"""Detect the board in all images of a calibration folder."""

import os
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from calibration.atomic_write import read_calibration_file
from calibration.dataset.folder import FolderContent, FolderView
from calibration.dataset.setup import Setup
from calibration.errors import BoardDetectionError, CalibrationFolderError
from calibration.observations import BoardView, Observations
from calibration.pose_estimation.corner_disambiguation import make_numbering_consistent
from calibration.target.detection import BoardSighting, detect_board

__all__ = ["DetectedViews", "board_view", "detect_views", "make_views_consistent", "read_image"]

MAX_IMAGE_BYTES = 128 << 20
"""Maximum size of an image file."""

OnView = Callable[[str, BoardSighting | str], None]
"""Called with the name of a view, and its detected corners or the reason why there are none."""


@dataclass(frozen=True, eq=False)
class DetectedViews:
    """The corners in all images of a folder."""

    observations: Observations
    """Views to solve from."""
    held_out: Observations
    """Views for verification; often none."""
    excluded: tuple[tuple[str, str], ...]
    """Views that cannot be used, with those of the folder: name and reason."""


def detect_views(content: FolderContent, on_view: OnView | None = None) -> DetectedViews:
    """Detect the board in every image of a folder. An image without a board is excluded and named in the result.

    Args:
        content: The folder, as `read_folder` returns it.
        on_view: Called after each view, to report progress.

    Raises:
        BoardDetectionError: No image shows the board. The message has the reason for the first image.
    """
    setup, excluded = content.setup, list(content.excluded)
    views: list[BoardView] = []
    is_unique: list[bool] = []
    first_error: BoardDetectionError | None = None
    for view in content.views:
        try:
            sighting = detect_board(read_image(view.image, setup.image_size), setup.board)
        except (BoardDetectionError, CalibrationFolderError) as error:
            excluded.append((view.name, str(error)))
            if isinstance(error, BoardDetectionError):
                first_error = first_error or type(error)(f"no image shows the board; {view.name}: {error}")
            if on_view is not None:
                on_view(view.name, str(error))
            continue
        views.append(board_view(view, sighting))
        is_unique.append(sighting.is_numbering_unique)
        if on_view is not None:
            on_view(view.name, sighting)
    if not views and first_error is not None:
        raise first_error
    held_out = {view.name for view in content.views if view.held_out}
    return DetectedViews(*make_views_consistent(setup, views, is_unique, held_out), tuple(excluded))


def make_views_consistent(
    setup: Setup, views: Sequence[BoardView], is_unique: Sequence[bool], held_out: Collection[str]
) -> tuple[Observations, Observations]:
    """Number all views of a symmetric board from the same corner, and separate the held-out views.

    Args:
        setup: Board, camera and robot.
        views: N views.
        is_unique: (N,) whether the numbering of a view is unique (`BoardSighting.is_numbering_unique`).
        held_out: Names of the views for verification.

    Returns:
        The views to solve from, and the views for verification.
    """
    consistent = make_numbering_consistent(setup.observations(tuple(views)), is_unique).views
    return (
        setup.observations(tuple(view for view in consistent if view.name not in held_out)),
        setup.observations(tuple(view for view in consistent if view.name in held_out)),
    )


def board_view(view: FolderView, sighting: BoardSighting) -> BoardView:
    """Return the view with its detected corners."""
    return BoardView(view.name, view.T_base_flange, sighting.ids, sighting.pixels, sighting.corner_sigma_px)


def read_image(path: str | os.PathLike[str], size: tuple[int, int]) -> NDArray[np.uint8]:
    """Return the pixels of an image file as the sensor had them. The orientation in its metadata is ignored.

    Args:
        path: The image file.
        size: Expected width and height, pixels.

    Returns:
        (H, W) grey or (H, W, 3) BGR image.

    Raises:
        CalibrationFolderError: The file cannot be read, or the image has another size.
    """
    import cv2

    path = Path(path)
    content = read_calibration_file(path, MAX_IMAGE_BYTES, "put the image back, or remove its pose too")
    try:
        encoded = np.frombuffer(content, dtype=np.uint8)
        image = cv2.imdecode(encoded, cv2.IMREAD_ANYCOLOR | cv2.IMREAD_IGNORE_ORIENTATION) if content else None
    except cv2.error as error:
        raise CalibrationFolderError(f"{path} is not an image: {error.err}") from error
    if image is None:
        raise CalibrationFolderError(f"{path} is not an image or is damaged: use PNG, JPEG, BMP or TIFF")
    height, width = image.shape[:2]
    if (width, height) != size:
        raise CalibrationFolderError(
            f"{path} has {width} x {height} pixels, and setup.json says {size[0]} x {size[1]}: use images of that "
            "size, because the camera matrix K is valid for one size only"
        )
    return image.astype(np.uint8, copy=False)
