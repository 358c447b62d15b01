"""Scans, recordings and problem documents of the service."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, TypeAlias

from pointchain_client.documents.decoding import rest_of_members
from pointchain_client.documents.findings import Finding, Verdict

ScanState: TypeAlias = str
"""State of a scan, for example `scanning` or `succeeded`. Later services may add states."""
RESULT_STATES = frozenset({"succeeded", "partial"})
"""Final states of a scan that has a model."""
FINAL_STATES = RESULT_STATES | {"failed", "aborted", "interrupted"}
"""Final states."""
ID_PATTERN = r"[0-9a-z-]{1,64}"
"""Form of the ids of the service."""
SLUG_PREFIX = "urn:pointchain:"
"""Prefix of the types of problems."""


@dataclass(frozen=True)
class Problem:
    """A problem document (RFC 9457): why a request was refused, or why a scan has no model."""

    type: str
    """Type of the problem, a URN. `slug` is its last part."""
    title: str
    """Short description for people, the same for each problem of this type."""
    status: int
    """HTTP status."""
    detail: str
    """Description for people of what happened and what to do."""
    instance: str | None = None
    """Path of the request or of the scan."""
    parameters: Mapping[str, Any] = field(default_factory=dict)
    """Values that `detail` contains, by name."""
    other: Mapping[str, Any] = rest_of_members()
    """Further members, such as `errors` of `invalid-request`."""

    @property
    def slug(self) -> str:
        """Type of the problem without its prefix, for example `cell-busy`. Programs decide by it."""
        return self.type.removeprefix(SLUG_PREFIX)


@dataclass(frozen=True)
class ViewProgress:
    """One viewpoint of a live scan."""

    index: int
    """Number of the viewpoint."""
    state: str
    """`moving` on the path there, `recorded` when the view is stored, `missing` if there is no view."""
    reason: str | None
    """Why the view is missing. None unless it is."""


@dataclass(frozen=True)
class Progress:
    """Progress of a scan in its resource."""

    stage: str | None
    """Present or last stage."""
    fraction: float
    """Completed share, 0 to 1. It never decreases."""
    views: tuple[ViewProgress, ...]
    """The viewpoints of a live scan that were reached so far, by index."""
    elapsed_s: float | None
    """Time since the first move of a live scan, seconds. None before it, and when the scan has ended."""
    remaining_s: float | None
    """Expected time until the model, seconds, 0 if the scan takes longer. None where `elapsed_s` is."""


@dataclass(frozen=True)
class ViewDurations:
    """Durations of the parts of one view, seconds."""

    index: int
    """Number of the viewpoint."""
    move: float
    """Moving the arm to the viewpoint."""
    settle: float
    """Waiting at the viewpoint."""
    exposure: float
    """Capturing and reading the exposures."""


@dataclass(frozen=True)
class ScanTiming:
    """Durations of the parts of a scan, seconds. Those that are not known are None."""

    wait: float | None
    """From the request until the work began."""
    connect: float | None
    """Connecting arm and camera. Nearly 0 if they were connected."""
    plan: float | None
    """Planning the viewpoints."""
    expected_to_model: float | None
    """From the first move of a live scan until the model, by the plan. With `auto` views, four views are expected."""
    expected_to_home: float | None
    """From the first move of a live scan until the arm is home, by the plan."""
    views: tuple[ViewDurations, ...]
    """The recorded views, by index."""
    recognition: Mapping[str, float]
    """Stages of recognition by their names, as in the model."""
    to_model: float | None
    """From the request until the model was complete."""
    to_home: float | None
    """From the request until the arm was home. It is known some seconds after the state is final."""


@dataclass(frozen=True)
class ScanSummary:
    """Summary of the model of a scan."""

    chains: int
    """Number of chains."""
    crossings: int
    """Number of crossings."""
    verdict: Verdict
    """Verdict on the whole model."""
    doubts: tuple[Finding, ...]
    """The doubts and blocking findings, the most serious first, at most 20."""
    doubt_count: int
    """Number of all doubts and blocking findings."""
    note_count: int
    """Number of notes."""


@dataclass(frozen=True)
class ScanLinks:
    """Paths of a scan. The path of a result is None until the result exists."""

    self: str
    """The scan."""
    events: str
    """Its events."""
    cancel: str | None
    """Cancels it. None unless the scan can be cancelled."""
    reprocess: str | None
    """Recognises its recording again. None until the scan has ended, or if it has no recording."""
    source: str | None
    """The scan that was reprocessed as this one."""
    recording: str | None
    """Its recording, an MCAP file."""
    model: str | None
    """Its model."""
    grasps: str | None
    """The grasps of its model."""
    cloud: str | None
    """Its point cloud, a PLY file."""
    height_map: str | None
    """Height of the table and of all that lies on it. None without a string in view."""
    preview: str | None
    """A picture of its model."""
    thumbnail: str | None
    """A small picture of its model."""
    views: str | None
    """Camera poses of its views."""


@dataclass(frozen=True)
class Scan:
    """One scan, running or ended."""

    id: str
    """Id of the scan."""
    mode: str
    """`live` or `replay`."""
    recording: str | None
    """Id of the recording. None if a live scan has none yet."""
    source: str | None
    """Id of the scan that was reprocessed as this one."""
    method: str
    """Recognition method."""
    string_radius_m: float | None
    """Radius that recognition uses, metres. None if it is measured."""
    all_grasps: bool
    """Whether the model also has the grasps on parts of strings with a doubt."""
    views: int | str | None
    """Number of viewpoints of a live scan, or `auto`. None for a replay."""
    state: ScanState
    """State of the scan."""
    final: bool
    """Whether the scan has ended, so that its state does not change any more."""
    progress: Progress
    """Progress of the scan."""
    created_at: str
    """Time of the request, RFC 3339."""
    started_at: str | None
    """Time of the start, RFC 3339."""
    ended_at: str | None
    """Time of the end, RFC 3339."""
    summary: ScanSummary | None
    """Summary of the model. None if there is no model."""
    problem: Problem | None
    """Why the scan failed, was aborted or interrupted."""
    requested_by: str | None
    """Name of the token that the scan was started with. None if no token was needed."""
    kept: bool
    """Whether a person has marked the scan to be kept."""
    calibration_sha256: str | None
    """SHA-256 of the hand-eye calibration that a live scan was planned with. None until it is planned."""
    simulated: bool | None
    """Whether the arm or the camera is simulated. None if the recording does not say."""
    timing_s: ScanTiming
    """Durations of its parts, seconds."""
    links: ScanLinks
    """Paths of the scan and its results."""


@dataclass(frozen=True)
class ScanList:
    """One page of the list of scans."""

    scans: tuple[Scan, ...]
    """The scans, the newest first."""
    next: str | None
    """Path of the next page. None on the last page."""


@dataclass(frozen=True)
class RecordingLinks:
    """Paths of a recording."""

    self: str
    """The recording's resource."""
    file: str
    """The MCAP file."""


@dataclass(frozen=True)
class Recording:
    """A stored recording, with values from its header and its contents."""

    id: str
    """Id of the recording."""
    name: str | None
    """Name that its sender gave. None if there was none, or if a live scan made the recording."""
    created_at: str
    """Time of the upload, or of the request for the live scan that made it, RFC 3339."""
    size_bytes: int
    """Size of the file."""
    sha256: str
    """SHA-256 of the file."""
    views: int
    """Number of complete views."""
    missing: tuple[str, ...]
    """Messages about what is missing from the file."""
    string_radius_m: float | None
    """Radius of the string, metres. None if it is not known."""
    table_z_m: float
    """Height of the table, metres, base frame."""
    simulated: bool | None
    """Whether the arm or the camera was simulated. None if the recording does not say."""
    provenance: Mapping[str, str]
    """Further values in the header, for example camera, robot and seed."""
    links: RecordingLinks
    """Paths of the recording."""
