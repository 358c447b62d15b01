"""Recognise a recording and write the files of the result, for the recognition process and for the command line."""

import hashlib
import json
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from calibration.atomic_write import write_synced
from cell.devices import View
from cell.recording import Recording, RecordingHeader, read_recording
from recognition.early_end.view_sufficiency import ViewChecks
from recognition.errors import InsufficientViewsError
from recognition.model.document import finding_json
from recognition.model.findings import Finding, finding
from recognition.model.model import PointChainModel
from recognition.model.provenance import Provenance
from recognition.model.trust import Verdict
from recognition.preprocessing.target_cloud import DepthView, Scene
from recognition.registration.hand_eye_error import HandEyeErrorEstimate
from recognition.request import RecognitionRequest
from service.clock import format_utc
from service.processing.height_map_file import StoredHeightMap, to_npz
from service.processing.preview import draw_preview
from service.processing.view_outcomes import ViewOutcome, view_outcomes
from service.storage.data_folder import CLOUD, HEIGHT_MAP, MODEL

if TYPE_CHECKING:
    from recognition.result import Recognition

OnStage = Callable[[str], None]
"""Called with the name of a stage when it begins."""

READING, WRITING = "reading", "writing"
"""Stages before and after those of recognition."""

STAGE_START_FRACTION = {
    READING: 0.0,
    "preprocess": 0.02,
    "registration": 0.4,
    "centre_line": 0.65,
    "matching": 0.66,
    "reconstruction": 0.72,
    "refinement": 0.72,
    "topology": 0.82,
    "grasps": 0.85,
    WRITING: 0.88,
}
"""Fraction of the total time that has passed when a stage begins, measured on scans of eight views."""

MAX_SUMMARY_DOUBTS = 20
"""Maximum number of doubts in the summary of a scan. The model has all of them."""

FIRST_TIME_S = 946_684_800.0
"""Earliest stamp that is a time, seconds since the epoch: the beginning of the year 2000."""


@dataclass(frozen=True)
class Source:
    """What the service knows about the source of a model, for its provenance."""

    scan: str | None = None
    """Id of the scan."""
    recording_sha256: str | None = None
    """SHA-256 of the recording. None: the recording is not complete yet."""


UNKNOWN_SOURCE = Source()
"""Source of a model that no scan of the service made."""
DEFAULT_REQUEST = RecognitionRequest()
"""Request for the radius of the recording, and the default gripper."""


@dataclass(frozen=True)
class Outcome:
    """Summary of a result, and its model."""

    model: Mapping[str, Any]
    """Document of the model."""
    chains: int
    """Number of chains."""
    crossings: int
    """Number of crossings."""
    verdict: Verdict
    """Verdict on the whole model."""
    findings: tuple[Finding, ...]
    """All findings of the model, the most serious first."""
    partial: bool
    """True if views are missing or were excluded."""
    calibration_error: HandEyeErrorEstimate | None = None
    """Hand-eye error that registration estimated from the views. None: not estimated."""
    files: dict[str, dict[str, Any]] = field(default_factory=dict)
    """SHA-256 and size of each written file, as JSON values, by file name."""
    timing_s: dict[str, float] = field(default_factory=dict)
    """Duration of each stage of recognition, seconds."""
    views: tuple[ViewOutcome, ...] = ()
    """Outcome of each view that recognition was given."""

    def summary(self) -> dict[str, Any]:
        """Return what is stored in the row of the scan, as JSON values."""
        doubts = [found for found in self.findings if found.severity != "note"]
        return {
            "chains": self.chains,
            "crossings": self.crossings,
            "verdict": self.verdict,
            "doubts": [finding_json(found) for found in doubts[:MAX_SUMMARY_DOUBTS]],
            "doubt_count": len(doubts),
            "note_count": len(self.findings) - len(doubts),
            "partial": self.partial,
        }


def recognise_recording(
    path: Path,
    request: RecognitionRequest = DEFAULT_REQUEST,
    on_stage: OnStage | None = None,
    source: Source = UNKNOWN_SOURCE,
) -> "Recognition":
    """Recognise a recording. The findings of the model list what is missing from the file.

    Args:
        path: The recording.
        request: How to recognise it. Without a radius, that of the recording is used; without one there, it is
            measured.
        on_stage: Called with the name of each stage when it begins.
        source: Scan and hash of the recording, for the provenance of the model.

    Raises:
        RecordingError: The file cannot be used.
        RecognitionError: The radius or the views cannot be used.
    """
    if on_stage is not None:
        on_stage(READING)
    recording = read_recording(path)
    request = request.or_radius(recording.header.string_radius_m)
    notes = recording_findings(recording)
    return recognise_views(recording.views, recording.header, notes, request, on_stage=on_stage, source=source)


def recognise_views(
    views: Iterable[View],
    header: RecordingHeader,
    missing: Sequence[Finding],
    request: RecognitionRequest,
    *,
    on_stage: OnStage | None = None,
    source: Source = UNKNOWN_SOURCE,
    checks: ViewChecks | None = None,
) -> "Recognition":
    """Recognise the views of a recording or of a running scan. Each view is processed as it arrives.

    Args:
        views: The views.
        header: Header of the recording.
        missing: Findings on missing views. They become findings of the model, and are read after the last view.
        request: How to recognise the views.
        on_stage: Called with the name of each stage when it begins.
        source: Scan and hash of the recording, for the provenance of the model.
        checks: Receives what is doubtful after each view, from the third on. None: only all views are recognised.

    Raises:
        RecognitionError: The radius or the views cannot be used. If too few views can be used, the message also says
            what is missing from the recording.
    """
    # not at the top: the service imports this module without recognition
    from recognition.early_end.stepwise import recognise_after_each_view
    from recognition.pipeline import recognise

    scene = Scene(header.table_z_m, header.workspace_m)
    taken = _TakenViews()
    arriving = taken.noting(views)

    def recognise_some(some: Iterable[DepthView], earlier: "Recognition | None" = None) -> "Recognition":
        return recognise(some, request, scene, on_stage=on_stage, earlier=earlier)

    try:
        if checks is None:
            recognition = recognise_some(arriving)
        else:
            recognition = recognise_after_each_view(arriving, recognise_some, checks.on_check, checks.next_is_here)
    except InsufficientViewsError as error:
        incomplete = [found.message for found in missing if found.code == "recording-incomplete"]
        raise InsufficientViewsError("; ".join([str(error), *incomplete])) from error
    recognition = recognition.with_findings(missing)
    provenance = _provenance(header, taken, source)
    return replace(recognition, model=replace(recognition.model, provenance=provenance))


@dataclass
class _TakenViews:
    """What the provenance says of the views."""

    last_stamp_s: float = -math.inf
    """Time of the last view, seconds since the epoch."""
    with_intensity: int = 0
    """Number of views that have an intensity image."""

    def noting(self, views: Iterable[View]) -> Iterator[View]:
        """Yield the views, and note each."""
        for view in views:
            self.last_stamp_s = max(self.last_stamp_s, view.stamp_s)
            if view.intensity is not None:
                self.with_intensity += 1
            yield view


def _provenance(header: RecordingHeader, taken: _TakenViews, source: Source) -> Provenance:
    last_stamp_s = taken.last_stamp_s
    # Imported views without a time have small stamps.
    has_time = last_stamp_s >= FIRST_TIME_S
    return Provenance(
        release=version("pointchain"),
        scan=source.scan,
        captured_at=format_utc(datetime.fromtimestamp(last_stamp_s, UTC)) if has_time else None,
        recording_sha256=source.recording_sha256,
        calibration_sha256=header.provenance.get("calibration_sha256"),
        simulated=header.simulated,
        intensity_views=taken.with_intensity,
    )


def recording_findings(recording: Recording, known: Sequence[Finding] = ()) -> list[Finding]:
    """Return a note for each message about a recording. `known` has notes on what is missing that the file hides."""
    incomplete = [finding("recording-incomplete", message) for message in recording.missing]
    return [
        *dict.fromkeys((*known, *incomplete)),
        *(finding("colour-unusable", message) for message in recording.unusable_colour),
    ]


def write_results(recognition: "Recognition", folder: Path) -> Outcome:
    """Create `folder`, write the measured files of the result into it, each synced to the disk, and return the outcome.

    The files are `cloud.ply` and, if the views were registered, `height-map.npz`. `write_model` adds `model.json`.
    """
    folder.mkdir()
    model = recognition.model
    contents = {CLOUD: to_ply(merged_cloud(recognition))}
    if recognition.height_map is not None and recognition.height_map.z_m.size and recognition.grasping is not None:
        floor = recognition.grasping.floor
        contents[HEIGHT_MAP] = to_npz(StoredHeightMap(recognition.height_map, floor.table_z_m, floor.min_height_m))
    for name, content in contents.items():
        write_synced(folder / name, content)
    registration = recognition.registration
    return Outcome(
        model=model.to_json(),
        chains=len(model.chains),
        crossings=len(model.crossings),
        verdict=model.quality.verdict,
        findings=model.quality.findings,
        partial=_has_excluded_views(model),
        calibration_error=None if registration is None else registration.hand_eye_error,
        files={name: hash_and_size(content) for name, content in contents.items()},
        timing_s=dict(model.timing_s),
        views=view_outcomes(recognition),
    )


def write_model(outcome: Outcome, folder: Path, recording_sha256: str | None) -> Outcome:
    """Write `model.json` with the hash of its recording, synced to the disk.

    Args:
        outcome: Outcome of `write_results`.
        folder: Folder of the files of the result.
        recording_sha256: SHA-256 of the recording, which a live scan completes after the recognition. None: there is no
            recording.

    Returns:
        The outcome with the hash of the file.
    """
    content = json.dumps(with_recording_hash(outcome.model, recording_sha256), allow_nan=False).encode()
    write_synced(folder / MODEL, content)
    return replace(outcome, files=outcome.files | {MODEL: hash_and_size(content)})


def with_recording_hash(model: Mapping[str, Any], sha256: str | None) -> dict[str, Any]:
    """Return the document of a model with the hash of its recording. None: there is no recording."""
    return {**model, "provenance": {**model["provenance"], "recording_sha256": sha256}}


def write_preview(recognition: "Recognition", path: Path) -> None:
    """Write the preview of the result, synced to the disk. It is separate because it takes longer than recognition."""
    write_synced(path, draw_preview(recognition.model, merged_cloud(recognition)))


def merged_cloud(recognition: "Recognition") -> NDArray[np.float64]:
    """Return the points (N, 3) of all views, base frame, metres. N is zero if recognition ended before registration."""
    registration = recognition.registration
    return np.zeros((0, 3)) if registration is None else registration.points


def to_ply(points: NDArray[np.float64]) -> bytes:
    """Return points (N, 3) as a binary PLY file, in metres as float32 (resolution 0.1 micrometres at one metre)."""
    header = (
        "ply\nformat binary_little_endian 1.0\ncomment metres, base frame\n"
        f"element vertex {len(points)}\nproperty float x\nproperty float y\nproperty float z\nend_header\n"
    )
    return header.encode() + np.ascontiguousarray(points, dtype="<f4").tobytes()


def hash_and_size(content: bytes) -> dict[str, Any]:
    """Return what the row of a scan says about a file of its result, as JSON values."""
    return {"sha256": hashlib.sha256(content).hexdigest(), "size_bytes": len(content)}


def _has_excluded_views(model: PointChainModel) -> bool:
    # without a string in the scene no view is used, and the result is complete all the same
    return bool(model.chains) and not all(view.used for view in model.quality.views)
