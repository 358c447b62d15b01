"""From a recording to the files of a result; shared by the HTTP service's worker and the command line."""

import hashlib
import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibration.atomic_write import write_synced
from cell.devices import View
from cell.recording.writer import RecordingHeader, read_recording
from recognition.grasping.gripper import Gripper
from recognition.model.model import Method, PointChainModel
from recognition.parameters import ChainParameters
from recognition.pipeline import Recognition, recognise
from recognition.preprocessing.target_cloud import Scene
from recognition.registration.hand_eye_error import HandEyeErrorEstimate
from service.processing.preview import draw_preview
from service.processing.view_outcomes import ViewOutcome, view_outcomes
from service.storage.data_folder import CLOUD, MODEL

OnStage = Callable[[str], None]

READING, WRITING = "reading", "writing"
"""The stages around those of recognition."""

DONE_BEFORE = {
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
"""Share of the whole time, as measured on scans of eight views, that is over when a stage begins."""


@dataclass(frozen=True)
class Outcome:
    """A result in short."""

    chains: int
    crossings: int
    warnings: tuple[str, ...]
    partial: bool
    """Views were missing or were left out."""
    calibration_error: HandEyeErrorEstimate | None = None
    """What the views tell of their calibration's error."""
    files: dict[str, dict[str, Any]] = field(default_factory=dict)
    """SHA-256 and size of each file that was written, as JSON."""
    timing_s: dict[str, float] = field(default_factory=dict)
    """How long each stage of recognition took."""
    views: tuple[ViewOutcome, ...] = ()

    def summary(self) -> dict[str, Any]:
        """What is kept in the scan's row, as JSON."""
        return {
            "chains": self.chains,
            "crossings": self.crossings,
            "warnings": list(self.warnings),
            "partial": self.partial,
        }


def check_radius(asked_m: float | None, recorded_m: float | None) -> float | None:
    """The radius to work with, metres: the one asked for, else the recording's; None, so that it is measured, if none.

    Raises:
        InvalidParametersError: it is no string's radius.
    """
    radius = recorded_m if asked_m is None else asked_m
    return None if radius is None else ChainParameters.for_radius(radius).r


def recognise_recording(
    path: Path,
    radius_m: float | None = None,
    method: Method = "graph",
    on_stage: OnStage | None = None,
    gripper: Gripper | None = None,
    settings: Mapping[str, float] | None = None,
) -> Recognition:
    """The recording at `path`, recognised; what is missing from the file is among the model's warnings.

    `radius_m` in metres, None for the recording's own; where that has none, it is measured. Grasps are for
    `gripper`, the default one if None. `on_stage` is called with the name of each stage when it begins. `settings` are
    parameter values by name, in place of those for the radius.

    Raises:
        RecordingError: the file cannot be used.
        RecognitionError: the radius, or what was recorded, cannot be used.
    """
    if on_stage is not None:
        on_stage(READING)
    recording = read_recording(path)
    radius = check_radius(radius_m, recording.header.string_radius_m)
    return recognise_views(
        recording.views, recording.header, recording.missing, radius, method, on_stage, gripper, settings
    )


def recognise_views(
    views: Iterable[View],
    header: RecordingHeader,
    missing: Sequence[str],
    radius_m: float | None,
    method: Method = "graph",
    on_stage: OnStage | None = None,
    gripper: Gripper | None = None,
    settings: Mapping[str, float] | None = None,
) -> Recognition:
    """The views of a recording, or of a scan under way, recognised; each is worked on as it comes.

    `missing` says what is not there, and need not be complete before the last view: it goes into the model's warnings.

    Raises:
        RecognitionError: the radius, or what was recorded, cannot be used.
    """
    parameters = None if radius_m is None else ChainParameters.for_radius(radius_m)
    scene = Scene(header.table_z_m, header.workspace_m)
    recognition = recognise(views, parameters, scene, method, on_stage, gripper, settings)
    model = recognition.model
    quality = replace(model.quality, warnings=(*missing, *model.quality.warnings))
    return replace(recognition, model=replace(model, quality=quality))


def write_results(recognition: Recognition, folder: Path) -> Outcome:
    """Writes model.json and cloud.ply into the new folder `folder`, each synced to disk."""
    folder.mkdir()
    model, points = recognition.model, merged_cloud(recognition)
    contents = {MODEL: json.dumps(model.to_json(), allow_nan=False).encode(), CLOUD: to_ply(points)}
    for name, content in contents.items():
        write_synced(folder / name, content)
    return Outcome(
        len(model.chains),
        len(model.crossings),
        model.quality.warnings,
        _views_left_out(model),
        None if recognition.registration is None else recognition.registration.hand_eye_error,
        {name: _as_written(content) for name, content in contents.items()},
        dict(model.timing_s),
        view_outcomes(recognition),
    )


def write_preview(recognition: Recognition, path: Path) -> None:
    """Writes the picture of the result, synced to disk. By itself, since it takes longer than recognition."""
    write_synced(path, draw_preview(recognition.model, merged_cloud(recognition)))


def merged_cloud(recognition: Recognition) -> NDArray[np.float64]:
    """Points (N, 3) of all views together, base frame, metres; none when recognition ended before merging."""
    registration = recognition.registration
    return np.zeros((0, 3)) if registration is None else registration.points


def to_ply(points: NDArray[np.float64]) -> bytes:
    """Points (N, 3) as a binary PLY file, metres as float32 (0.1 micrometres at one metre)."""
    header = (
        "ply\nformat binary_little_endian 1.0\ncomment metres, base frame\n"
        f"element vertex {len(points)}\nproperty float x\nproperty float y\nproperty float z\nend_header\n"
    )
    return header.encode() + np.ascontiguousarray(points, dtype="<f4").tobytes()


def _as_written(content: bytes) -> dict[str, Any]:
    return {"sha256": hashlib.sha256(content).hexdigest(), "size_bytes": len(content)}


def _views_left_out(model: PointChainModel) -> bool:
    # Where there is no string no view shows one, and none was needed.
    return bool(model.chains) and not all(view.used for view in model.quality.views)
