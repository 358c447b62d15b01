"""Calibration and verification in the cell: the arm visits the poses while the board is detected in the images.

Each image and its pose are on the disk before the arm leaves the pose, in the folder format of
`calibration.dataset.folder`. The images of a run that failed can still be solved with `pointchain calibrate solve`. The
solver starts when the arm is home. It keeps this process busy, and the watchdog would stop a moving arm that is not
polled in time.
"""

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from calibration.atomic_write import replace_synced
from calibration.dataset.folder import HAND_EYE_FILE, SETUP_FILE, write_setup, write_view
from calibration.dataset.setup import Setup
from calibration.dataset.view_detection import make_views_consistent
from calibration.errors import BoardDetectionError, CalibrationFolderError, HandEyeError
from calibration.observations import BoardView
from calibration.result import HandEyeResult
from calibration.storage.hand_eye_file import write_result
from calibration.verification.verification import Verification, verification_findings, verify
from cell.control.cell import Cell
from cell.control.prepared import PreparedCalibration, PreparedVerification
from cell.control.progress import BoardObservation, ProgressListener
from cell.devices import View
from cell.errors import CalibrationError, MissingViewsError

MAX_IMAGE_BYTES = 1 << 20
"""Largest size of an image on the disk."""
BOARD_NOT_SEEN = (
    "lay it flat in the middle of the workspace, print up, evenly lit and without reflections; if the camera was "
    "remounted since the last calibration, remove that calibration and set hand_eye.rough_xyz_m"
)
GRID_COLUMNS, GRID_ROWS = 8, 5
"""Grid of the image for the coverage with corners."""


@dataclass(frozen=True, eq=False)
class CalibrationRun:
    """Outcome of a calibration."""

    result: HandEyeResult
    """Calibration, which may be refused."""
    verification: Verification
    """Verification at the held-out poses. It has no views if the board was detected at none of them."""
    unused: tuple[tuple[str, str], ...]
    """Name and reason of each image without a board, then of each pose that was not reached or gave no frame."""


def run_calibration(
    cell: Cell, prepared: PreparedCalibration, folder: Path, listener: ProgressListener
) -> CalibrationRun:
    """Take the views, solve, verify, and write everything to the new `folder`. The arm is home on return.

    Args:
        cell: Cell that prepared the calibration.
        prepared: Result of `Cell.prepare_calibration`.
        folder: Folder for images and result, which must not hold a calibration.
        listener: Receives the progress.

    Returns:
        The calibration with its verification. Its verdict may be "refuse".

    Raises:
        CellError: As `Cell.run`. MissingViewsError also means that too few images show the board.
        HandEyeInputError: No calibration can be solved from these views.
        CalibrationFolderError: The folder holds a calibration already.
        OSError: A file cannot be written. Where this can be known, it is raised before any motion.
    """
    from calibration.hand_eye import solve_hand_eye

    images = _take_images(cell, prepared, folder, listener)
    observations, held_out = make_views_consistent(
        images.setup,
        tuple(images.views.values()),
        images.unique_numbering,
        {view.name for view in images.of(prepared.plan.held_out)},
    )
    if len(observations.views) < prepared.min_views:
        raise _too_few(len(observations.views), prepared.min_views, images)
    result = solve_hand_eye(observations)
    verification = verify(result, held_out)
    result = replace(result, findings=(*result.findings, *verification_findings(verification)))
    write_result(folder / HAND_EYE_FILE, result, observations, held_out, verification.to_json())
    return CalibrationRun(result, verification, tuple(images.unused))


def run_verification(
    cell: Cell, prepared: PreparedVerification, folder: Path, listener: ProgressListener
) -> Verification:
    """Take the views and judge the active calibration by them. The arm is home on return.

    Args:
        cell: Cell that prepared the verification.
        prepared: Result of `Cell.prepare_verification`.
        folder: Folder for the images, which must not hold a calibration.
        listener: Receives the progress.

    Raises:
        CalibrationError: The active calibration was changed meanwhile, or its images have another size.
        CellError: As `Cell.run`. MissingViewsError also means that an image does not show the board.
        CalibrationFolderError: The folder holds a calibration already.
        OSError: A file cannot be written.
    """
    images = _take_images(cell, prepared, folder, listener)
    views = images.of(range(len(prepared.plan.viewpoints)))
    if len(views) < prepared.min_views:
        raise _too_few(len(views), prepared.min_views, images)
    try:
        return verify(prepared.hand_eye, images.setup.observations(views))
    except HandEyeError as error:
        raise CalibrationError(str(error)) from error


def observe_board(view: BoardView, setup: Setup) -> BoardObservation:
    """Return how the board appears in a view that shows it."""
    from calibration.pose_estimation.board_pose import estimate_board_poses
    from calibration.pose_estimation.projection import stack_corners

    rms_px = float(estimate_board_poses(stack_corners(setup.observations((view,)))).rms_px[0])
    grid = (GRID_COLUMNS, GRID_ROWS)
    cells = (view.pixels / setup.image_size * grid).astype(np.int64).clip(0, (GRID_COLUMNS - 1, GRID_ROWS - 1))
    return BoardObservation(
        corners=len(view.ids),
        board_corners=len(setup.board.points),
        rms_px=rms_px if np.isfinite(rms_px) else None,
        cells=tuple(np.unique(cells @ (1, GRID_COLUMNS)).tolist()),
    )


@dataclass(eq=False)
class _Images:
    """Writes the images to the folder and detects the board in them. It is a `ViewWriter`."""

    prepared: PreparedCalibration | PreparedVerification
    folder: Path
    listener: ProgressListener
    views: dict[int, BoardView] = field(default_factory=dict)
    """Views that show the board, by the number of the pose, in the order of their capture."""
    unique_numbering: list[bool] = field(default_factory=list)
    """For each of `views`, whether the board's pattern determines which corner is the first."""
    unused: list[tuple[str, str]] = field(default_factory=list)
    """Name and reason of each image without a board, then of each pose without an image."""
    _setup: Setup | None = None
    _names: dict[int, str] = field(default_factory=dict)
    _covered: set[int] = field(default_factory=set)

    @property
    def setup(self) -> Setup:
        """Setup of the images, once there is one."""
        assert self._setup is not None
        return self._setup

    def of(self, poses: Iterable[int]) -> tuple[BoardView, ...]:
        """Return the views of these poses that show the board."""
        wanted = set(poses)
        return tuple(view for index, view in self.views.items() if index in wanted)

    def write_view(self, view: View) -> View:
        assert view.image is not None  # `take_views` rejects a frame without one
        if self._setup is None:
            height, width = view.image.shape[:2]
            self._setup = Setup(
                self.prepared.board,
                view.K,
                (width, height),
                camera_id=self.prepared.camera_id,
                robot_serial=self.prepared.robot_serial,
                created=datetime.now(UTC),
            )
            write_setup(self.folder, self._setup)
        # The names sort in the order of capture, which shows when a board was moved during the run.
        name = self._names[view.index] = f"{len(self._names):02d}_pose{view.index:02d}"
        write_view(self.folder, name, view.image, view.T_base_flange, view.index in self.prepared.plan.held_out)
        return view

    def detect(self, view: View) -> None:
        """Detect the board in a view that is on the disk."""
        from calibration.target.detection import detect_board

        assert view.image is not None  # as above
        name = self._names[view.index]
        try:
            detected = detect_board(view.image, self.prepared.board)
        except BoardDetectionError as error:
            self.unused.append((name, str(error)))
            self.listener.not_detected(view.index, str(error))
            return
        board_view = BoardView(name, view.T_base_flange, detected.ids, detected.pixels, detected.corner_sigma_px)
        self.views[view.index] = board_view
        self.unique_numbering.append(detected.is_numbering_unique)
        observation = observe_board(board_view, self.setup)
        self._covered.update(observation.cells)
        self.listener.detected(view.index, observation, len(self._covered) / (GRID_COLUMNS * GRID_ROWS))


def _take_images(
    cell: Cell, prepared: PreparedCalibration | PreparedVerification, folder: Path, listener: ProgressListener
) -> _Images:
    """Take all views of the plan and return home."""
    if (folder / SETUP_FILE).exists():
        raise CalibrationFolderError(
            f"{folder} already has a calibration, and none is overwritten: name another folder"
        )
    _require_space(folder, len(prepared.plan.viewpoints))
    images = _Images(prepared, folder, listener)
    with cell.run(prepared, images, listener) as views:
        for view in views:
            images.detect(view)
    images.unused += ((f"pose{view.index:02d}", view.reason) for view in views.missing)
    listener.home()
    return images


def _require_space(folder: Path, views: int) -> None:
    """Make the folder and check that the images fit on the disk, before the arm moves.

    Raises:
        OSError: They do not fit, or the folder cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    probe = folder / ".probe"
    try:
        replace_synced(probe, bytes(views * MAX_IMAGE_BYTES))
    finally:
        probe.unlink(missing_ok=True)


def _too_few(seen: int, needed: int, images: _Images) -> MissingViewsError:
    reasons = "; ".join(f"{name}: {reason}" for name, reason in images.unused[:3])
    return MissingViewsError(
        f"the board was seen in {seen} views, {needed} are needed: {BOARD_NOT_SEEN}. Reasons: {reasons}"
    )
