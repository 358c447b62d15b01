"""JSON documents of scans and recordings. Metres, radians, seconds, UTC.

The document of the point chain model is defined in `recognition.model.document`.
"""

from dataclasses import replace
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BeforeValidator, Field, StrictBool

from cell.config.cell_config import ScanViews
from cell.config.scan_views import VIEWS_NEEDED
from recognition.grasping.gripper import Gripper
from recognition.model.document import FindingDocument
from recognition.model.model import Method
from recognition.model.trust import Verdict
from recognition.parameters import R_MAX, R_MIN
from recognition.request import RecognitionRequest
from service.api.schemas.base import ApiModel, RequestModel
from service.api.schemas.problem import Problem
from service.processing.height_map_file import StoredHeightMap
from service.states import ID_PATTERN, ScanState, ViewState

Id = Annotated[str, Field(pattern=ID_PATTERN, examples=["20260102t030405-678901-9f86d081"])]
"""Id that the service assigns. Ids sort by the time of their creation."""

# limits only for the OpenAPI document: recognition enforces them, also for the radius of a recording, with a message
# that says more than "should be less than"
Radius = Annotated[
    float, Field(strict=True, allow_inf_nan=False, json_schema_extra={"minimum": R_MIN, "maximum": R_MAX})
]


def _to_whole_number(value: Any) -> int:
    if isinstance(value, float) and value.is_integer():
        return int(value)
    if isinstance(value, bool) or not isinstance(value, int):
        raise ValueError("must be a whole number")
    return value


WHOLE_NUMBER = BeforeValidator(_to_whole_number)
"""Validator of whole numbers in JSON. It accepts 3.0, but neither "3" nor true."""


def _refuse_text(value: Any) -> Any:
    if isinstance(value, str) and value != "auto":
        raise ValueError(VIEWS_NEEDED)
    return value


ViewChoice = Annotated[ScanViews, BeforeValidator(_refuse_text)]
"""Number of viewpoints as a JSON number, or "auto"."""


class _Request(RequestModel):
    string_radius_m: Radius | None = None
    """Radius of the string. Null means that of the recording or the cell; if that has none, it is measured."""
    method: Method = "graph"
    all_grasps: StrictBool = False
    """Whether the model also has the grasps on parts of strings with a doubt. Their `trusted` is false."""
    validate_only: StrictBool = False
    """Whether the request is only checked. No scan is started, and the answer is 200 or the same refusal."""

    def recognition_request(self, gripper: Gripper, default_radius_m: float | None) -> RecognitionRequest:
        """Return how to recognise the scan.

        Args:
            gripper: Configured gripper.
            default_radius_m: Radius of the recording or of the cell, metres; None if it has none.

        Raises:
            InvalidParametersError: The radius is not the radius of a string.
        """
        request = RecognitionRequest(self.method, self.string_radius_m, {}, gripper, self.all_grasps)
        return request.or_radius(default_radius_m)


class ReplayScanRequest(_Request):
    """A scan from a recording."""

    mode: Literal["replay"]
    recording: Id


class LiveScanRequest(_Request):
    """A scan by the cell's arm and camera."""

    mode: Literal["live"]
    views: ViewChoice | None = None
    """Number of viewpoints, or "auto": one ring of four viewpoints, and four more only if something is doubtful. Null
    means as configured."""


class ReprocessRequest(RequestModel):
    """Body of a request to recognise the views of a scan again. Omitted members are as in that scan."""

    string_radius_m: Radius | None = None
    """Radius of the string. Null means that it is measured, even if the recording has one."""
    method: Method | None = None
    all_grasps: StrictBool | None = None
    """Whether the model also has the grasps on parts of strings with a doubt."""

    def recognition_request(self, gripper: Gripper, first: RecognitionRequest) -> RecognitionRequest:
        """Return how to recognise the scan again.

        Args:
            gripper: Configured gripper.
            first: Request of the scan.

        Raises:
            InvalidParametersError: The radius is not the radius of a string.
        """
        given = {name: getattr(self, name) for name in ("method", "all_grasps") if getattr(self, name) is not None}
        request = replace(first, gripper=gripper, **given)
        if "string_radius_m" in self.model_fields_set:
            request = replace(request, radius_m=self.string_radius_m)
        return request.or_radius(None)


class KeepRequest(RequestModel):
    """Whether a scan is kept at any age."""

    kept: StrictBool


ScanRequest = Annotated[ReplayScanRequest | LiveScanRequest, Field(discriminator="mode")]


class RecordingLinks(ApiModel):
    """Addresses of a recording."""

    self: str
    file: str


class RecordingResource(ApiModel):
    """A stored recording, with values from its header and its contents."""

    id: Id
    name: str | None
    """Name that its sender gave. Null if there was none, or if a live scan made the recording."""
    created_at: str
    """Time of the upload, or of the request for the live scan that made it, RFC 3339."""
    size_bytes: int
    sha256: str
    views: int
    """Number of complete views."""
    missing: list[str]
    """Messages about what is missing from the file."""
    string_radius_m: float | None
    table_z_m: float
    simulated: bool | None
    """Whether the arm or the camera was simulated. Null if the recording does not say."""
    provenance: dict[str, str]
    """Further values in the header, for example camera, robot and seed."""
    links: RecordingLinks


class RecordingList(ApiModel):
    """Recordings, the newest first."""

    recordings: list[RecordingResource]
    next: str | None
    """Address of the next page. Null on the last page."""


class ViewProgress(ApiModel):
    """One viewpoint of a live scan."""

    index: int
    state: ViewState
    """`moving` on the path there, `recorded` when the view is on the disk, `missing` if there is no view."""
    reason: str | None
    """Why the view is missing."""


class ScanProgress(ApiModel):
    """Progress of a scan."""

    stage: str | None
    """Present or last stage."""
    fraction: float = Field(ge=0, le=1)
    """Completed share by typical durations, 0 to 1. It never decreases."""
    views: list[ViewProgress]
    """The viewpoints of a live scan that were reached so far, by index."""
    elapsed_s: float | None
    """Time since the first move of a live scan. Null before it, and when the scan has ended."""
    remaining_s: float | None
    """Expected time until the model, 0 if the scan takes longer than expected. Null where `elapsed_s` is."""


class ViewDurations(ApiModel):
    """Durations of the parts of one view, seconds."""

    index: int
    move: float
    """Moving the arm to the viewpoint."""
    settle: float
    """Waiting at the viewpoint."""
    exposure: float
    """Capturing and reading the exposures."""


class ScanTiming(ApiModel):
    """Durations of the parts of a scan, seconds. Those that are not known are null."""

    wait: float | None
    """From the request until the work began. The arm of the last scan may have been on its way home."""
    connect: float | None
    """Connecting arm and camera. Nearly 0 if they were connected."""
    plan: float | None
    """Planning the viewpoints."""
    expected_to_model: float | None
    """From the first move of a live scan until the model, by the plan. With "auto" views, four views are expected."""
    expected_to_home: float | None
    """From the first move of a live scan until the arm is home, by the plan."""
    views: list[ViewDurations]
    """The recorded views, by index."""
    recognition: dict[str, float]
    """Stages of recognition by their names, as in the model. Those of early views run while the arm moves."""
    to_model: float | None
    """From the request until the model was complete."""
    to_home: float | None
    """From the request until the arm was home. It is known some seconds after the state is final."""


class ScanSummary(ApiModel):
    """Summary of a result."""

    chains: int
    crossings: int
    verdict: Verdict
    """Verdict on the whole model, as in the model."""
    doubts: list[FindingDocument]
    """The doubts and blocking findings of the model, the most serious first, at most 20."""
    doubt_count: int
    """Number of all doubts and blocking findings."""
    note_count: int
    """Number of notes. The model has them."""


class ScanLinks(ApiModel):
    """Addresses of a scan. The address of a result is null until the result exists."""

    self: str
    events: str
    cancel: str | None
    """Null unless the scan can be cancelled."""
    reprocess: str | None
    """Null until the scan has ended, or if it has no recording."""
    source: str | None
    """The scan that was reprocessed as this one."""
    recording: str | None
    model: str | None
    grasps: str | None
    cloud: str | None
    height_map: str | None
    """Null also without a string in view."""
    preview: str | None
    thumbnail: str | None
    views: str | None
    """Camera poses of the views. A live scan has this address from its beginning."""


class ScanResource(ApiModel):
    """One scan, running or ended."""

    id: Id
    mode: Literal["replay", "live"]
    recording: Id | None
    source: Id | None
    """Id of the scan that was reprocessed as this one. Null also after that scan was removed."""
    method: Method
    string_radius_m: float | None
    """The radius that recognition uses. Null if it is measured."""
    all_grasps: bool
    """Whether the model also has the grasps on parts of strings with a doubt."""
    views: ScanViews | None
    """Number of viewpoints of a live scan, or "auto". Null for a replay."""
    state: ScanState
    final: bool
    """True: the scan has ended, and its state does not change any more."""
    progress: ScanProgress
    created_at: str
    started_at: str | None
    ended_at: str | None
    summary: ScanSummary | None
    problem: Problem | None
    """Why the scan failed, was aborted or interrupted."""
    requested_by: str | None
    """Name of the token that the scan was started with. Null if no token was needed."""
    kept: bool
    """Whether a person has marked the scan to be kept. It is then not removed at any age."""
    calibration_sha256: str | None
    """SHA-256 of the hand-eye calibration that a live scan was planned with. Null until it is planned."""
    simulated: bool | None
    """Whether the arm or the camera is simulated. Null if the recording does not say."""
    timing_s: ScanTiming
    links: ScanLinks


class ScanList(ApiModel):
    """Scans, the newest first."""

    scans: list[ScanResource]
    next: str | None
    """Address of the next page, with the same filters. Null on the last page."""


class HeightMapDocument(ApiModel):
    """Height of the table and of all that lies on it, in square cells, as the median of the views."""

    frame: Literal["base"]
    """The frame of all positions and heights: the base of the robot."""
    x_m: float
    """Position of the first edge of the first cell along x."""
    y_m: float
    """The same along y."""
    cell_m: float
    """Edge length of the cells. Cell (i, j) begins at x_m + i cell_m, y_m + j cell_m."""
    table_z_m: float
    """Height of the table plane."""
    min_object_height_m: float
    """Minimum height above the table of an object that is not noise."""
    z_m: list[list[float | None]]
    """Height of the surface in each cell, as z_m[i][j]. Null where no view measured it."""


def requested_members(request: RecognitionRequest) -> dict[str, Any]:
    """Return the members of a scan, or of its validation, that say how it is recognised."""
    return {"method": request.method, "string_radius_m": request.radius_m, "all_grasps": request.all_grasps}


def height_map_document(stored: StoredHeightMap) -> HeightMapDocument:
    """Return the document of a height map. Heights are rounded to a tenth of a millimetre, less than their noise."""
    heights = stored.heights
    z_m = (heights.z_m.astype(np.float64).round(4) + 0.0).astype(object)
    z_m[np.isnan(heights.z_m)] = None
    return HeightMapDocument.model_construct(  # not checked again: there are some 100,000 cells
        frame="base",
        x_m=round(heights.x_m, 6),
        y_m=round(heights.y_m, 6),
        cell_m=round(heights.cell_m, 6),
        table_z_m=round(stored.table_z_m, 6),
        min_object_height_m=round(stored.min_object_height_m, 6),
        z_m=z_m.tolist(),
    )
