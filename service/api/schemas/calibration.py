"""What goes over HTTP about hand-eye calibration, as JSON. Metres, radians, seconds, pixels, UTC."""

from typing import Annotated, Any, Literal

from pydantic import ConfigDict, Field, JsonValue

from calibration.result import Verdict
from calibration.storage.document import CalibrationResult, FindingResource, VerificationResource
from calibration.target.board import (
    MARKER_COUNTS,
    MAX_PER_SIDE,
    MAX_PITCH_M,
    MIN_PER_SIDE,
    MIN_PITCH_M,
    Board,
    BoardKind,
    board_with_defaults,
)
from cell.control.calibration_run import GRID_COLUMNS, GRID_ROWS
from service.api.schemas.base import Described
from service.api.schemas.problem import Problem
from service.api.schemas.scans import WHOLE, Id
from service.states import ScanState, ViewState

Matrix = list[list[float]]


class CellWarning(Described):
    """Something that does not keep the cell from scanning, but should be seen to."""

    code: str = Field(examples=["calibration-drift"])
    """For programs."""
    words: str
    """For people, and what to do."""


# Told to readers of the description only: the board itself refuses what is outside, with words that say more.
COUNT: dict[str, JsonValue] = {"minimum": min(MIN_PER_SIDE.values()), "maximum": MAX_PER_SIDE}
LENGTH: dict[str, JsonValue] = {"minimum": MIN_PITCH_M, "maximum": MAX_PITCH_M}


class BoardRequest(Described):
    """A calibration board, as printed; the usual one where nothing is told."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False, strict=True)

    kind: BoardKind | None = None
    columns: Annotated[int, WHOLE] | None = Field(default=None, json_schema_extra=COUNT)
    """Squares in a row, or dots."""
    rows: Annotated[int, WHOLE] | None = Field(default=None, json_schema_extra=COUNT)
    """Rows of squares, or of dots."""
    pitch_m: float | None = Field(default=None, json_schema_extra=LENGTH)
    """Side of a square, or distance from dot to dot, as measured on the print."""
    marker_m: float | None = Field(default=None, json_schema_extra=LENGTH)
    """Side of a ChArUco marker; in proportion to the squares unless told."""
    dictionary: str | None = Field(default=None, max_length=40, json_schema_extra={"enum": [*MARKER_COUNTS, None]})
    """OpenCV's name of the markers' dictionary."""

    def board(self) -> Board:
        """The usual board, but for what is told. Raises BoardError."""
        return board_with_defaults(self.model_dump(exclude_none=True))


class CalibrationRequest(Described):
    """A calibration by the cell."""

    model_config = ConfigDict(extra="forbid")

    board: BoardRequest | None = None
    """The board on the table; null is the usual one."""
    poses: Annotated[int, Field(ge=10, le=40), WHOLE] = 15
    """To solve from; two more verify the result."""


class CalibrationView(Described):
    """One view of a run."""

    index: int
    state: ViewState
    """`moving`: the arm was sent there; `recorded`: the picture is on the disk; `missing`: there is none."""
    reason: str | None
    """Why it is missing, or why the board was not found in it."""
    corners: int | None
    """Found in its picture; null: not looked for yet."""
    possible: int | None
    """That the board has."""
    rms_px: float | None
    """How far they are from where the board would have them by the pose that fits this picture alone best, each
    coordinate; null: not looked for yet, none were found, or no pose fits."""
    cells: list[Annotated[int, Field(ge=0, lt=GRID_COLUMNS * GRID_ROWS)]] | None
    """Parts of the picture, 8 across and 5 down, in which they are: row by row, 0 is the first of the upper row. All
    views' together are the coverage. Null: not looked for yet, or of an earlier version."""
    picture: str | None
    """Address of the picture."""


class CalibrationProgress(Described):
    """How far a run has come."""

    stage: str | None
    fraction: float = Field(ge=0, le=1)
    coverage: float = Field(ge=0, le=1)
    """Share of the image in which corners were seen so far."""
    views: list[CalibrationView]
    """Those come to so far, by their numbers."""


class RunLinks(Described):
    """Addresses of a run; null where there is nothing to be done."""

    self: str
    cancel: str | None
    activate: str | None


class RunResource(Described):
    """One calibration by the cell, or verification of the one in use, running or ended."""

    id: Id
    kind: Literal["calibration", "verification"]
    board: dict[str, Any] | None
    """Null: the one that the calibration in use was made with."""
    poses: int
    warnings: list[str]
    """What the poses that the arm reaches will not tell well."""
    state: ScanState
    progress: CalibrationProgress
    created_at: str
    started_at: str | None
    ended_at: str | None
    activated_at: str | None
    """When it was made the calibration in use."""
    calibration_sha256: str | None
    """Of a verification: which calibration it is of."""
    result: CalibrationResult | None
    """Of a calibration that succeeded; its verdict may still be that it must not be used."""
    verification: VerificationResource | None
    """How the calibration did on views that it was not solved from."""
    problem: Problem | None
    """Why it failed, was aborted or interrupted."""
    links: RunLinks


class RunList(Described):
    """Runs, the newest first."""

    runs: list[RunResource]


class DriftResource(Described):
    """What recent live scans tell of the calibration."""

    scans: int
    """How many were judged."""
    off_m: float
    """How far the camera seems to be from where it was, which is said by `off_from`."""
    off_rad: float
    """How far it seems to be turned from that."""
    off_from: Literal["calibration", "first-scans"]
    """From where the calibration puts it, or from where the first scans with this calibration had it."""
    chance: float
    """How likely so much is without a drift. One that is small, and no drift, is of too few scans, or of one alone."""
    drifted: bool
    words: str


class CalibrationInUse(Described):
    """The hand-eye calibration in use. What its file does not tell is null."""

    T_flange_camera: Matrix
    covariance: Matrix | None
    """Of its error (rx, ry, rz, tx, ty, tz) in the camera's frame, rad and m."""
    sigma_m: float | None
    sigma_rad: float | None
    eight_views_m: float | None
    verdict: Verdict | None
    findings: list[FindingResource]
    created_at: str | None
    age_s: float | None
    camera_id: str | None
    robot_serial: str | None
    board: dict[str, Any] | None
    sha256: str
    warnings: list[str]
    drift: DriftResource


class CalibrationStatus(Described):
    """Hand-eye calibration: the one in use, and what is under way."""

    calibration: CalibrationInUse | None
    """Null: there is none that can be used."""
    reason: str | None
    """Why there is none, and what to do."""
    warnings: list[CellWarning]
    under_way: str | None
    """Address of the run under way."""
