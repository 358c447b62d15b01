"""JSON documents of hand-eye calibration. Metres, radians, seconds, pixels, UTC."""

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
from service.api.schemas.base import ApiModel, RequestModel
from service.api.schemas.problem import Problem
from service.api.schemas.scans import WHOLE_NUMBER, Id
from service.states import ScanState, ViewState

Matrix = list[list[float]]


class CellWarning(ApiModel):
    """A condition that does not prevent scans but needs attention."""

    code: str = Field(examples=["calibration-drift"])
    """Code for programs."""
    message: str
    """Message for people, with what to do."""


# only for the OpenAPI document; `Board` enforces the limits, with messages that say more
COUNT: dict[str, JsonValue] = {"minimum": min(MIN_PER_SIDE.values()), "maximum": MAX_PER_SIDE}
LENGTH: dict[str, JsonValue] = {"minimum": MIN_PITCH_M, "maximum": MAX_PITCH_M}


class BoardRequest(RequestModel):
    """A calibration board, as printed. Omitted members are those of the default board."""

    model_config = ConfigDict(allow_inf_nan=False, strict=True)

    kind: BoardKind | None = None
    columns: Annotated[int, WHOLE_NUMBER] | None = Field(default=None, json_schema_extra=COUNT)
    """Number of squares or dots in a row."""
    rows: Annotated[int, WHOLE_NUMBER] | None = Field(default=None, json_schema_extra=COUNT)
    """Number of rows of squares or dots."""
    pitch_m: float | None = Field(default=None, json_schema_extra=LENGTH)
    """Side of a square, or distance between neighbouring dots, measured on the print, metres."""
    marker_m: float | None = Field(default=None, json_schema_extra=LENGTH)
    """Side of a ChArUco marker, metres. Null means in the default proportion to the squares."""
    dictionary: str | None = Field(default=None, max_length=40, json_schema_extra={"enum": [*MARKER_COUNTS, None]})
    """Name of the marker dictionary in OpenCV."""

    def board(self) -> Board:
        """Return the default board with the given members replaced.

        Raises:
            BoardError: Such a board cannot exist or be detected.
        """
        return board_with_defaults(self.model_dump(exclude_none=True))


class CalibrationRequest(RequestModel):
    """Body of a request for a calibration by the cell."""

    board: BoardRequest | None = None
    """The board on the table. Null means the default board."""
    poses: Annotated[int, Field(ge=10, le=40), WHOLE_NUMBER] = 15
    """Number of poses to solve from. Two more poses verify the result."""


class CalibrationView(ApiModel):
    """One view of a run."""

    index: int
    state: ViewState
    """`moving` on the path there, `recorded` when the image is on the disk, `missing` if there is no image."""
    reason: str | None
    """Why the view is missing, or why the board was not found in it."""
    corners: int | None
    """Number of corners found in the image. Null until the image is searched."""
    board_corners: int | None
    """Number of corners of the board."""
    rms_px: float | None
    """RMS reprojection error per coordinate, for the board pose that fits this image alone best, pixels.

    Null until the image is searched, and if no corner was found or no pose fits.
    """
    cells: list[Annotated[int, Field(ge=0, lt=GRID_COLUMNS * GRID_ROWS)]] | None
    """Cells of an 8 x 5 grid over the image (columns x rows) that contain corners.

    Numbered row by row from 0, the first cell of the top row. All views together give the coverage. Null until
    the image is searched.
    """
    image: str | None
    """Address of the image."""


class CalibrationProgress(ApiModel):
    """Progress of a run."""

    stage: str | None
    fraction: float = Field(ge=0, le=1)
    coverage: float = Field(ge=0, le=1)
    """Share of the image in which corners were found so far, 0 to 1."""
    views: list[CalibrationView]
    """The views reached so far, by index."""


class RunLinks(ApiModel):
    """Addresses of a run. An action that is not possible is null."""

    self: str
    cancel: str | None
    activate: str | None


class RunResource(ApiModel):
    """A calibration by the cell, or a verification of the calibration in use, running or ended."""

    id: Id
    kind: Literal["calibration", "verification"]
    board: dict[str, Any] | None
    """The board. Null means the board of the calibration in use."""
    poses: int
    warnings: list[str]
    """Quantities that the reachable poses do not determine well."""
    state: ScanState
    progress: CalibrationProgress
    created_at: str
    started_at: str | None
    ended_at: str | None
    activated_at: str | None
    """When the result became the calibration in use."""
    calibration_sha256: str | None
    """SHA-256 of the calibration that a verification checks."""
    result: CalibrationResult | None
    """Result of a calibration that succeeded. Its verdict may still be that it must not be used."""
    verification: VerificationResource | None
    """Errors of the calibration on views that it was not solved from."""
    problem: Problem | None
    """Why the run failed, was aborted or interrupted."""
    links: RunLinks


class RunList(ApiModel):
    """Calibrations and verifications, the newest first."""

    runs: list[RunResource]


class DriftResource(ApiModel):
    """Drift of the camera, estimated from recent live scans."""

    scans: int
    """Number of scans in the estimate."""
    deviation_m: float
    """Estimated displacement of the camera from `reference`, metres."""
    deviation_rad: float
    """Estimated rotation of the camera from `reference`, radians."""
    reference: Literal["calibration", "first-scans"]
    """The reference. The pose in the calibration, or the pose in the first scans with this calibration."""
    p_value: float
    """Probability of an estimate this large without a drift (p-value).

    It may be small without a drift being reported, if there are too few scans, or if one scan alone deviates.
    """
    drifted: bool
    message: str
    """Message for people."""


class ActiveCalibration(ApiModel):
    """The hand-eye calibration in use. Values that its file does not have are null."""

    T_flange_camera: Matrix
    covariance: Matrix | None
    """Covariance of its error (rx, ry, rz, tx, ty, tz) in the camera frame, radians and metres."""
    sigma_m: float | None
    sigma_rad: float | None
    repeatability_95_m: float | None
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


class CalibrationStatus(ApiModel):
    """The hand-eye calibration in use, and the running run."""

    calibration: ActiveCalibration | None
    """Null if no calibration is usable."""
    reason: str | None
    """Why no calibration is usable, and what to do."""
    warnings: list[CellWarning]
    active_run: str | None
    """Address of the running run."""
