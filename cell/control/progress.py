"""Progress of a scan, a calibration or a verification while the arm moves."""

from dataclasses import dataclass
from typing import Protocol

from recognition.model.findings import Finding, finding


@dataclass(frozen=True)
class MissingView:
    """A planned viewpoint without a view."""

    index: int
    """Number of the viewpoint."""
    reason: str
    """Why there is no view."""

    @property
    def message(self) -> str:
        """Warning of the model about the missing view."""
        return f"view {self.index} is missing: {self.reason}"

    @property
    def finding(self) -> Finding:
        """Finding of the model about the missing view."""
        return finding("view-missing", self.message, view=self.index)


@dataclass(frozen=True)
class ViewTiming:
    """Durations of the parts of one view, seconds."""

    move_s: float
    """Moving the arm to the viewpoint."""
    settle_s: float
    """Waiting at the viewpoint, so that the arm and the camera come to rest."""
    exposure_s: float
    """Capturing the exposures and reading them. A camera that was connected again takes longer."""


@dataclass(frozen=True)
class BoardObservation:
    """The board in one image, before anything is solved."""

    corners: int
    """Number of detected corners."""
    board_corners: int
    """Number of corners of the board."""
    rms_px: float | None
    """Root mean square reprojection error per coordinate for the best pose of this image alone, or None without one."""
    cells: tuple[int, ...]
    """Cells of the 8 x 5 grid with a corner, row by row from the upper left."""


class ProgressListener(Protocol):
    """Receives the progress of a scan, a calibration or a verification. An exception of the listener ends it.

    The arm's thread calls `moving`, `recorded` and `missing`. The caller's thread calls `detected`, `not_detected` and
    `home`, which a scan does not have.
    """

    def moving(self, index: int) -> None:
        """Receive that the arm will move to viewpoint `index` when this returns."""
        ...

    def recorded(self, index: int, timing: ViewTiming) -> None:
        """Receive that the view of viewpoint `index` is on the disk, and how long it took."""
        ...

    def missing(self, index: int, reason: str) -> None:
        """Receive that viewpoint `index` gives no view, and why."""
        ...

    def detected(self, index: int, board: BoardObservation, coverage: float) -> None:
        """Receive that the image of viewpoint `index` shows the board.

        Args:
            index: Number of the viewpoint.
            board: The board in this image.
            coverage: Share of the grid's cells in which any image so far has a corner.
        """
        ...

    def not_detected(self, index: int, reason: str) -> None:
        """Receive that the board cannot be detected in the image of viewpoint `index`, and why."""
        ...

    def home(self) -> None:
        """Receive that all images are taken and the arm is home. The solver starts next."""
        ...
