"""Measure how much accuracy recognition loses on point clouds, compared with the depth images that they come from.

Prints the table of docs/researcher/own-data.md, on simulated scans of random strings. Ten scenes take about ten
minutes.

    python examples/point_cloud_accuracy.py [SCENES]
"""

import sys
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from cell.cloud import CloudRequest, import_cloud
from cell.simulation.evaluation.metrics import Score, score
from cell.simulation.offline_scan import SimulatedScan, simulate, write_simulation
from cell.simulation.pose_errors import NO_ERRORS, PoseErrors
from cell.simulation.rendering.depth_camera import camera_model
from cell.simulation.scenes.scenes import make_scene
from recognition.errors import RecognitionError
from recognition.preprocessing import deproject
from service.processing.results import recognise_recording, to_ply


@dataclass(frozen=True)
class Form:
    """One row of the table."""

    name: str
    noise: bool
    """Whether the depth images have the noise of an OAK-D Pro."""
    errors: PoseErrors
    """Errors of the camera poses."""
    merged: bool
    """Whether all points are in one file that does not say which view saw them."""


FORMS = (
    Form("a file for each viewpoint, OAK-D Pro noise and pose errors", True, PoseErrors(), False),
    Form("bare merged file, no noise, exact poses", False, NO_ERRORS, True),
    Form("bare merged file, no noise, pose errors", False, PoseErrors(), True),
    Form("bare merged file, OAK-D Pro noise and pose errors", True, PoseErrors(), True),
)


def scan_of(seed: int, form: Form) -> SimulatedScan:
    """Return eight views of a random string of 0.4 m with up to two crossings."""
    camera = camera_model("ideal")
    scene = make_scene("random", seed, crossings=seed % 3)
    return simulate(scene, camera if form.noise else replace(camera, noise=None), seed, form.errors)


def recognised(recording: Path, scan: SimulatedScan) -> Score | None:
    """Return the score of the recording's model; None if recognition refuses."""
    try:
        return score(recognise_recording(recording).model.to_json(), scan.truth)
    except RecognitionError:
        return None


def as_clouds(scan: SimulatedScan, merged: bool, folder: Path) -> Path:
    """Write the scan's points as PLY files, import these, and return the recording."""
    clouds = [deproject(view, *np.nonzero(view.depth)) for view in scan.views]
    if merged:
        clouds = [np.vstack(clouds)]
    files = [folder / f"{k}.ply" for k in range(len(clouds))]
    for file, points in zip(files, clouds, strict=True):
        file.write_bytes(to_ply(points))
    header = scan.header
    request = CloudRequest(
        viewpoints_m=[view.T_base_camera[:3, 3].tolist() for view in scan.views],
        string_radius_m=header.string_radius_m,
        table_z_m=header.table_z_m,
        workspace_m=header.workspace_m,
    )
    recording = folder / "clouds.mcap"
    import_cloud(files, recording, request)
    return recording


def median_mm(scores: list[Score]) -> str:
    """Return the median of the mean errors."""
    errors = [each.mean_m for each in scores if each.mean_m is not None]
    return f"{np.median(errors) * 1000:.2f} mm" if errors else "none"


def row(form: Form, scenes: int) -> str:
    """Return the table's row of a form, over the scenes with seeds from 0."""
    own_scores, right, none = [], [], 0
    for seed in range(scenes):
        scan = scan_of(seed, form)
        with tempfile.TemporaryDirectory() as name:
            own = Path(name) / "own.mcap"
            write_simulation(scan, own)
            own_score = recognised(own, scan)
            cloud_score = recognised(as_clouds(scan, form.merged, Path(name)), scan)
        if own_score is not None:
            own_scores.append(own_score)
        if cloud_score is None or cloud_score.chains == 0:
            none += 1
        elif cloud_score.topology:
            right.append(cloud_score)
    return f"| {form.name} | {scenes} | {len(right)} | {none} | {median_mm(own_scores)} | {median_mm(right)} |"


def main() -> None:
    """Print the table, each row as it is measured."""
    scenes = int(sys.argv[1]) if len(sys.argv) > 1 else 10
    print("| form | scenes | right | no string found | error, own depth images | error, point clouds that are right |")
    print("|---|---|---|---|---|---|", flush=True)
    for form in FORMS:
        print(row(form, scenes), flush=True)


if __name__ == "__main__":
    main()
