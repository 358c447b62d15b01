"""Calibrating and verifying in the cell: the arm goes from look to look while the board is found in the pictures.

Every picture and its pose are on the disk before the arm leaves, in the folder form of `calibration.dataset.folder`:
what was taken until something went wrong can still be solved with `pointchain calibrate solve`. The solution is worked
out when the arm is home: it keeps this process busy, and a moving arm is stopped by its watchdog when it is not heard
in time.
"""

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Protocol

from calibration.atomic_write import replace_synced
from calibration.dataset.folder import HAND_EYE_FILE, SETUP_FILE, write_setup, write_view
from calibration.dataset.setup import Setup
from calibration.dataset.view_detection import make_views_consistent
from calibration.errors import BoardDetectionError, CalibrationFolderError, HandEyeError
from calibration.input_checks.observations import MIN_VIEWS
from calibration.observations import BoardView
from calibration.result import HandEyeResult
from calibration.storage.hand_eye_file import write_result
from calibration.target.board import Board
from calibration.verification.verification import Verification, verification_findings, verify
from cell.control.board_observation import ACROSS, DOWN, BoardSeen, board_seen
from cell.control.cell import Cell
from cell.control.scan_loop import ScanListener
from cell.devices import View
from cell.errors import CalibrationError, MissingViewsError
from cell.planning.viewpoints import ViewpointPlan

PICTURE_BYTES = 1 << 20
"""No picture takes more on the disk."""
NOT_SEEN = (
    "lay it flat in the middle of the workspace, print up, evenly lit and without reflections; if the camera was "
    "mounted otherwise since the last calibration, take that one away and tell hand_eye.rough_xyz_m"
)


class CalibrationListener(ScanListener, Protocol):
    """Who is told how it goes. `seen`, `unseen` and `home` come from the thread that calibrates, the others from
    the arm's."""

    def seen(self, index: int, board: BoardSeen, coverage: float) -> None:
        """The board is in the picture from pose `index`.

        `coverage`: the share of the picture's parts (8 x 5) in which corners were seen so far.
        """
        ...

    def unseen(self, index: int, reason: str) -> None:
        """It is not, or cannot be made out."""
        ...

    def home(self) -> None:
        """All views are taken and the arm stands at home; what they give is worked out now."""
        ...


@dataclass(frozen=True, eq=False)
class CalibrationRun:
    """What came of it."""

    result: HandEyeResult
    verification: Verification
    """On the poses that were held out; without views where the board was seen from none of them."""
    unseen: tuple[tuple[str, str], ...]
    """Poses that gave nothing, name and reason: not reached, failed by the camera, or without the board."""


def run_calibration(
    cell: Cell, plan: ViewpointPlan, folder: Path, board: Board, listener: CalibrationListener
) -> CalibrationRun:
    """Takes the views of a plan of `Cell.prepare_calibration`, solves, verifies, and writes it all to the new `folder`.

    The arm is home on return. The result may be a refused one.

    Raises:
        CellError: as a scan does; MissingViewsError too when too few views show the board.
        HandEyeInputError: no calibration can be solved from such views.
        CalibrationFolderError: there is a calibration in the folder already.
        OSError: a file cannot be written; before any move where that shows by then.
    """
    from calibration.hand_eye import solve_hand_eye

    looks = _look(cell, plan, folder, board, listener, MIN_VIEWS)
    observations, held_out = make_views_consistent(
        looks.setup, tuple(looks.views.values()), looks.certain, {view.name for view in looks.of(plan.held_out)}
    )
    if len(observations.views) < MIN_VIEWS:
        raise _too_few(len(observations.views), MIN_VIEWS, looks)
    result = solve_hand_eye(observations)
    verification = verify(result, held_out)
    result = replace(result, findings=(*result.findings, *verification_findings(verification)))
    write_result(folder / HAND_EYE_FILE, result, observations, held_out, verification.to_json())
    return CalibrationRun(result, verification, tuple(looks.unseen))


def run_verification(cell: Cell, plan: ViewpointPlan, folder: Path, listener: CalibrationListener) -> Verification:
    """Takes the views of a plan of `Cell.prepare_verification`, and judges the calibration in use by them.

    The calibration is the one that the plan was made with; no move begins once it is no longer in use. The arm is home
    on return. Raises as `run_calibration`, and CalibrationError when the calibration was changed since, or is of images
    of another size.
    """
    hand_eye = cell.made_with(plan)
    assert hand_eye.board is not None
    looks = _look(cell, plan, folder, hand_eye.board, listener, len(plan.viewpoints))
    views = looks.of(range(len(plan.viewpoints)))
    if len(views) < len(plan.viewpoints):
        raise _too_few(len(views), len(plan.viewpoints), looks)
    try:
        return verify(hand_eye, looks.setup.observations(views))
    except HandEyeError as error:
        raise CalibrationError(str(error)) from error


@dataclass(eq=False)
class _Looks:
    """What was seen, and what keeps it: a `ViewWriter`, and a listener that passes on what it is told."""

    folder: Path
    board: Board
    held_out: tuple[int, ...]
    camera_id: str | None
    robot_serial: str | None
    listener: CalibrationListener
    views: dict[int, BoardView] = field(default_factory=dict)
    """Those that show the board, by the pose's index, in the order in which they were taken."""
    certain: list[bool] = field(default_factory=list)
    """Whether it is plain which of the board's corners is the first; as long as `views`."""
    unseen: list[tuple[str, str]] = field(default_factory=list)
    _setup: Setup | None = None
    _names: dict[int, str] = field(default_factory=dict)
    _covered: set[int] = field(default_factory=set)

    @property
    def setup(self) -> Setup:
        """Of a calibration with at least one view."""
        assert self._setup is not None
        return self._setup

    def of(self, poses: Iterable[int]) -> tuple[BoardView, ...]:
        """The views from these poses that show the board."""
        wanted = set(poses)
        return tuple(view for index, view in self.views.items() if index in wanted)

    def moving(self, index: int) -> None:
        self.listener.moving(index)

    def recorded(self, index: int) -> None:
        self.listener.recorded(index)

    def missing(self, index: int, reason: str) -> None:
        self.unseen.append((f"pose{index:02d}", reason))
        self.listener.missing(index, reason)

    def write_view(self, view: View) -> View:
        assert view.image is not None
        if self._setup is None:
            height, width = view.image.shape[:2]
            self._setup = Setup(
                self.board,
                view.K,
                (width, height),
                camera_id=self.camera_id,
                robot_serial=self.robot_serial,
                created=datetime.now(UTC),
            )
            write_setup(self.folder, self._setup)
        # By name the views lie in the order in which they were taken: a board that was moved midway shows by it.
        name = self._names[view.index] = f"{len(self._names):02d}_pose{view.index:02d}"
        write_view(self.folder, name, view.image, view.T_base_flange, view.index in self.held_out)
        return view

    def detect(self, view: View) -> None:
        """Looks for the board in a view that is on the disk."""
        from calibration.target.detection import detect_board

        assert view.image is not None
        name = self._names[view.index]
        try:
            sighting = detect_board(view.image, self.board)
        except BoardDetectionError as error:
            self.unseen.append((name, str(error)))
            self.listener.unseen(view.index, str(error))
            return
        self.views[view.index] = shown = BoardView(
            name, view.T_base_flange, sighting.ids, sighting.pixels, sighting.corner_sigma_px
        )
        self.certain.append(sighting.is_numbering_unique)
        seen = board_seen(shown, self.setup)
        self._covered.update(seen.cells)
        self.listener.seen(view.index, seen, len(self._covered) / (ACROSS * DOWN))


def _look(
    cell: Cell, plan: ViewpointPlan, folder: Path, board: Board, listener: CalibrationListener, least: int
) -> _Looks:
    """Takes all views of the plan; the arm is home on return."""
    if (folder / SETUP_FILE).exists():
        raise CalibrationFolderError(f"{folder} holds a calibration already, which is never overwritten: name another")
    _require_room(folder, len(plan.viewpoints))
    status = cell.status
    looks = _Looks(
        folder,
        board,
        plan.held_out,
        None if status.camera is None else status.camera.device_id,
        None if status.arm is None else status.arm.serial,
        listener,
    )
    with cell.calibrating(plan, looks, looks, least) as views:
        for view in views:
            looks.detect(view)
    listener.home()
    return looks


def _require_room(folder: Path, views: int) -> None:
    """Makes the folder and sees that the pictures can be written there, before the arm moves for nothing.

    Raises:
        OSError: they cannot.
    """
    folder.mkdir(parents=True, exist_ok=True)
    probe = folder / ".probe"
    try:
        replace_synced(probe, bytes(views * PICTURE_BYTES))
    finally:
        probe.unlink(missing_ok=True)


def _too_few(seen: int, least: int, looks: _Looks) -> MissingViewsError:
    # First why the board was not seen in pictures, and then which poses gave none.
    by_picture = sorted(looks.unseen, key=lambda each: each[0].startswith("pose"))
    reasons = "; ".join(f"{name}: {reason}" for name, reason in by_picture[:3])
    return MissingViewsError(
        f"the board was seen in {seen} views, {least} are needed: {NOT_SEEN}. Among the others, {reasons}"
    )
