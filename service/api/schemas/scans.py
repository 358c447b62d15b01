"""What goes over HTTP, as JSON: requests, recordings, scans, problems. Metres, radians, seconds, UTC.

The point chain model's own document is defined in `recognition.model.document`.
"""

from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, ConfigDict, Field, StrictBool

from recognition.model.document import GraspDocument
from recognition.model.model import Method
from recognition.parameters import R_MAX, R_MIN
from service.api.schemas.base import Described
from service.api.schemas.problem import Problem
from service.states import ID_PATTERN, ScanState, ViewState

Id = Annotated[str, Field(pattern=ID_PATTERN, examples=["20260102t030405-678901-9f86d081"])]
"""Made by the server; later ones sort behind earlier ones."""

# The bounds are told to readers of the description only: recognition itself refuses a radius outside of them,
# the recording's too, with a message that says more than "should be less than".
Radius = Annotated[
    float, Field(strict=True, allow_inf_nan=False, json_schema_extra={"minimum": R_MIN, "maximum": R_MAX})
]


def _whole(value: Any) -> int:
    if isinstance(value, float) and value.is_integer():
        return int(value)
    if isinstance(value, bool) or not isinstance(value, int):
        raise ValueError("a whole number is needed")
    return value


WHOLE = BeforeValidator(_whole)
"""Makes an int a whole number as JSON has it: 3.0 is one, "3" and true are not."""


class _Request(Described):
    model_config = ConfigDict(extra="forbid")

    string_radius_m: Radius | None = None
    """Radius of the string; null takes the recording's or the cell's, and where that has none it is measured."""
    method: Method = "graph"


class ReplayScan(_Request):
    """A scan from a recording."""

    mode: Literal["replay"]
    recording: Id


class LiveScan(_Request):
    """A scan by the cell's arm and camera."""

    mode: Literal["live"]
    views: Annotated[int, Field(ge=2, le=32), WHOLE] | None = None
    """How many viewpoints; null takes the cell's."""


class Reprocess(Described):
    """The same views, recognised again. What is left out is as in the scan that it is of."""

    model_config = ConfigDict(extra="forbid")

    string_radius_m: Radius | None = None
    """Radius of the string; null measures it, whatever the recording says."""
    method: Method | None = None


class Keep(Described):
    """Whether a scan is kept for ever."""

    model_config = ConfigDict(extra="forbid")

    kept: StrictBool


ScanRequest = Annotated[ReplayScan | LiveScan, Field(discriminator="mode")]


class RecordingLinks(Described):
    """Addresses of a recording."""

    self: str
    file: str


class RecordingResource(Described):
    """A stored recording: what its header says and what is in it."""

    id: Id
    name: str | None
    """What it was called by who sent it; null: it was not told, or a live scan made it."""
    created_at: str
    """When it was uploaded, or the live scan that made it was asked for, RFC 3339."""
    size_bytes: int
    sha256: str
    views: int
    """Complete views."""
    missing: list[str]
    """What is missing from the file, in words."""
    string_radius_m: float | None
    table_z_m: float
    provenance: dict[str, str]
    """What else the header says: camera, robot, seed ..."""
    links: RecordingLinks


class RecordingList(Described):
    """Recordings, the newest first."""

    recordings: list[RecordingResource]
    next: str | None
    """Where the list goes on; null: it ends here."""


class ViewProgress(Described):
    """One viewpoint of a live scan."""

    index: int
    state: ViewState
    """`moving`: the arm was sent there; `recorded`: the view is on the disk; `missing`: there is none."""
    reason: str | None
    """Why it is missing."""


class Progress(Described):
    """How far a scan has come."""

    stage: str | None
    """What is being done, or was done last."""
    fraction: float = Field(ge=0, le=1)
    """Done of the whole, by typical times; never falls."""
    views: list[ViewProgress]
    """Of a live scan: the viewpoints come to so far, by their numbers."""


class ScanSummary(Described):
    """A result in short."""

    chains: int
    crossings: int
    warnings: list[str]


class ScanLinks(Described):
    """Addresses of a scan; those of results are null until it has them."""

    self: str
    events: str
    cancel: str | None
    """Only while the scan can be cancelled."""
    reprocess: str | None
    """Only once it has ended, and where there is a recording."""
    source: str | None
    """The scan that it does again."""
    recording: str | None
    model: str | None
    grasps: str | None
    cloud: str | None
    preview: str | None
    thumbnail: str | None
    views: str | None
    """From where each view was taken; of a live scan from its beginning on."""


class ScanResource(Described):
    """One scan, running or ended."""

    id: Id
    mode: Literal["replay", "live"]
    recording: Id | None
    source: Id | None
    """The scan that it does again; null too once that one was removed."""
    method: Method
    string_radius_m: float | None
    """The radius that recognition works with; null: it is measured."""
    state: ScanState
    progress: Progress
    created_at: str
    started_at: str | None
    ended_at: str | None
    summary: ScanSummary | None
    problem: Problem | None
    """Why it failed, was aborted or interrupted."""
    asked_by: str | None
    """Name of the token that it was started with; null: nobody had to say who he is."""
    kept: bool
    """A person wants it kept: it is not removed, however old."""
    calibration_sha256: str | None
    """Of the hand-eye calibration that a live scan was planned with."""
    links: ScanLinks


class ScanList(Described):
    """Scans, the newest first."""

    scans: list[ScanResource]
    next: str | None
    """Where the list goes on, with the same filters; null: it ends here."""


class GraspsDocument(Described):
    """The grasps of a model, without the rest of the model."""

    model_config = ConfigDict(extra="allow")

    schema_: Literal["pointchain/1"] = Field(alias="schema")
    frame: Literal["base"]
    grasps: list[GraspDocument]
    """The best first."""
