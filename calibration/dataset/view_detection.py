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
from calibration.target.detection import DetectedBoard, detect_board

__all__ = ["DetectedViews", "board_view", "detect_views", "make_views_consistent", "read_image"]

MAX_IMAGE_BYTES = 128 << 20
"""Maximum size of an image file, bytes."""

OnView = Callable[[str, DetectedBoard | str], None]
"""Callback for one view. The arguments are the view name, and its detected corners or the reason for its exclusion."""


@dataclass(frozen=True, eq=False)
class DetectedViews:
    """Detected corners in all images of a folder."""

    observations: Observations
    """Observations with the views for the solver."""
    held_out: Observations
    """Observations with the views for verification, which may be empty."""
    excluded: tuple[tuple[str, str], ...]
    """(name, reason) of each view or file that cannot be used, including `FolderContent.excluded`."""


def detect_views(content: FolderContent, on_view: OnView | None = None) -> DetectedViews:
    """Detect the board in every image of a folder.

    An image that is not readable or does not show the board is excluded, and the result gives the reason. If no image
    is readable, the result has no views.

    Args:
        content: Content of the folder, from `read_folder`.
        on_view: Progress callback, called after each view; None for no callback.

    Raises:
        BoardDetectionError: At least one image is readable, and no image shows the board. The message gives the reason
            for the first readable image.
    """
    setup = content.setup
    excluded = list(content.excluded)
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
    """Make the corner numbers of a symmetric board consistent in all views, and separate the held-out views.

    Args:
        setup: Board, camera and robot.
        views: N views.
        is_unique: (N,) True for views with a unique numbering (`DetectedBoard.is_numbering_unique`).
        held_out: Names of the views for verification.

    Returns:
        Observations with the views for the solver, and observations with the views for verification.
    """
    consistent = make_numbering_consistent(setup.observations(tuple(views)), is_unique).views
    return (
        setup.observations(tuple(view for view in consistent if view.name not in held_out)),
        setup.observations(tuple(view for view in consistent if view.name in held_out)),
    )


def board_view(view: FolderView, sighting: DetectedBoard) -> BoardView:
    """Combine the name and flange pose of a view with its detected corners."""
    return BoardView(view.name, view.T_base_flange, sighting.ids, sighting.pixels, sighting.corner_sigma_px)


def read_image(path: str | os.PathLike[str], size: tuple[int, int]) -> NDArray[np.uint8]:
    """Read an image file. The orientation in the metadata is ignored, because `K` belongs to the unrotated pixels.

    Args:
        path: The image file.
        size: Expected width and height, pixels.

    Returns:
        (H, W) grey or (H, W, 3) BGR image.

    Raises:
        CalibrationFolderError: The file cannot be read, is not an image, or does not have the expected size.
    """
    import cv2

    path = Path(path)
    content = read_calibration_file(path, MAX_IMAGE_BYTES, "put the image back, or remove its pose too")
    image = None
    try:
        if content:  # OpenCV does not decode an empty buffer.
            encoded = np.frombuffer(content, dtype=np.uint8)
            image = cv2.imdecode(encoded, cv2.IMREAD_ANYCOLOR | cv2.IMREAD_IGNORE_ORIENTATION)
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
