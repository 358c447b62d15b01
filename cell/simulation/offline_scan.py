"""Simulated scan without a cell: the views as a cell would record them, and the truth."""

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cell.config.rendering_options import RenderingOptions
from cell.devices import View
from cell.planning.look_at import Bearing
from cell.recording import RecordingExistsError, RecordingHeader, RecordingWriter
from cell.simulation.pose_errors import T_FLANGE_CAMERA, PoseErrors, perturbed, reported_flange_poses, viewpoints
from cell.simulation.rendering.depth_camera import (
    CameraModel,
    DepthCamera,
    ImageContent,
    draw_bias_px,
    image_provenance,
)
from cell.simulation.rendering.image_cache import ImageCache
from cell.simulation.scenes.clutter import footprint
from cell.simulation.scenes.ground_truth import scene_truth
from cell.simulation.scenes.scenes import StringScene

WORKSPACE_TOP_M = 0.12
"""Height of the recorded workspace."""
WORKSPACE_HALF_M = 0.26
"""Smallest half width of the recorded workspace."""

_FIRST_STAMP_S = 1_767_225_600.0
"""Stamp of the first view, the beginning of 2026. A simulated scan does not depend on the clock."""
_VIEW_TIME_S = 3.0

# streams of one seed, so that draws for different purposes are independent
_SESSION, _POSES, _VIEW = range(3)


class ViewCountError(ValueError):
    """The number of views is out of range."""

    slug = "views"


@dataclass(frozen=True, eq=False)
class SimulatedScan:
    """Result of `simulate`."""

    views: tuple[View, ...]
    header: RecordingHeader
    truth: Mapping[str, Any]
    """Truth as JSON, by `cell.simulation.scenes.ground_truth.scene_truth`."""


def simulate(
    scene: StringScene,
    camera: CameraModel,
    seed: int,
    errors: PoseErrors | None = None,
    views: int = 8,
    T_base_table: NDArray[np.float64] | None = None,
    bearings: Sequence[Bearing] | None = None,
    workspace_half_m: float | None = None,
    rendering: RenderingOptions | None = None,
    cache: ImageCache | None = None,
) -> SimulatedScan:
    """Simulate a scan of a scene from viewpoints on two rings. The same arguments give the same content.

    Args:
        scene: Strings on the table.
        camera: Camera model.
        seed: Seed of noise and errors.
        errors: Errors of the reported poses. None means the defaults of `PoseErrors`.
        views: Number of views, 1 to 64.
        T_base_table: True pose (4, 4) of the table with the scene on it. The recording states a level table at z = 0.
            None means that this is true.
        bearings: Bearing of each view from the table's origin. None means bearings on two rings.
        workspace_half_m: Half width of the recorded workspace, which all views show completely. None means at least
            `WORKSPACE_HALF_M`, and views that show the strings. A single view shows no such workspace, so None then
            means the width that the strings need.
        rendering: Options of the rendered images. None means the defaults.
        cache: Keeps rendered images between runs. None means that they are not kept.

    Raises:
        ViewCountError: `views` is out of range.
        RenderingOptionsError: The camera does not have the options.
    """
    if not 1 <= views <= 64:
        raise ViewCountError(f"{views} views; from 1 to 64 are allowed")
    errors = PoseErrors() if errors is None else errors
    points = _subject(scene)
    needed = float(np.abs(points[:, :2]).max()) + 0.03
    half = max(WORKSPACE_HALF_M, needed)
    if workspace_half_m is None and views == 1:
        workspace_half_m = needed
    if workspace_half_m is not None:
        half = workspace_half_m
        points = half * np.array([(x, y, 0.0) for x in (-1, 1) for y in (-1, 1)])
    size = (camera.width, camera.height)
    T_base_table = np.eye(4) if T_base_table is None else T_base_table
    T_table_camera = viewpoints(points, camera.K, size, camera.near_m, camera.working_m, views, bearings)
    T_base_camera = [T_base_table @ T for T in T_table_camera]
    pose_rng = np.random.default_rng([seed, _POSES])
    T_flange_camera = T_FLANGE_CAMERA
    nominal_T_flange_camera = perturbed(T_flange_camera, errors.hand_eye_m, errors.hand_eye_rad, pose_rng)
    reported_T_base_flange = reported_flange_poses(T_base_camera, T_flange_camera, errors, pose_rng, seed)
    bias_px = draw_bias_px(camera, np.random.default_rng([seed, _SESSION]))
    rendering = RenderingOptions() if rendering is None else rendering
    depth_camera = DepthCamera(camera, scene, bias_px, seed, ImageContent(rendering), cache)
    header = RecordingHeader(
        depth_unit_m=camera.depth_unit_m,
        string_radius_m=scene.radius_m,
        table_z_m=0.0,
        workspace_m=((-half, half), (-half, half), (0.0, WORKSPACE_TOP_M)),
        T_flange_camera=nominal_T_flange_camera,
        simulated=True,
        provenance=_provenance(scene, camera, rendering, seed),
    )
    images = [
        depth_camera.capture_images(T, np.random.default_rng([seed, _VIEW, k])) for k, T in enumerate(T_table_camera)
    ]
    taken = tuple(
        View(
            index=k,
            depth=images[k].depth,
            intensity=images[k].intensity,
            depth_unit_m=camera.depth_unit_m,
            K=camera.K,
            T_base_flange=reported_T_base_flange[k],
            T_flange_camera=nominal_T_flange_camera,
            stamp_s=_FIRST_STAMP_S + k * _VIEW_TIME_S,
        )
        for k in range(views)
    )
    return SimulatedScan(taken, header, scene_truth(scene, T_base_camera, T_flange_camera, T_base_table))


def _provenance(scene: StringScene, camera: CameraModel, rendering: RenderingOptions, seed: int) -> dict[str, str]:
    """Return what was simulated, for the recording."""
    simulated = {"camera": f"simulated {camera.name}", "robot": "simulated", "scene": scene.name, "seed": str(seed)}
    return simulated | image_provenance(camera, rendering, seed)


def _subject(scene: StringScene) -> NDArray[np.float64]:
    """Return the points (N, 3) that the camera looks at, the strings or else the clutter."""
    if scene.curves:
        return np.vstack(scene.curves)
    flat = [footprint(box) for box in scene.boxes] + [np.array([clump.centre_m]) for clump in scene.clumps]
    on_table = np.vstack([np.zeros((1, 2)), *flat])
    return np.column_stack([on_table, np.zeros(len(on_table))])


def truth_path(path: Path) -> Path:
    """Return the path of the truth, `scan.truth.json` beside `scan.mcap`."""
    return path.with_suffix(".truth.json")


def refuse_existing(path: Path) -> None:
    """Raise RecordingExistsError if the recording or its truth exists.

    Args:
        path: Recording to write.
    """
    for there in (path, truth_path(path)):
        if there.exists():
            raise RecordingExistsError(f"{there} exists already; nothing is overwritten: choose another name")


def write_simulation(scan: SimulatedScan, path: Path) -> Path:
    """Write the recording and the truth beside it, each completely or not at all. Return the path of the truth.

    Args:
        scan: Simulated scan.
        path: Recording to write.

    Raises:
        RecordingExistsError: One of the files exists.
        RecordingError: The views cannot be recorded.
        OSError: A file cannot be written.
    """
    beside = truth_path(path)
    refuse_existing(path)
    unfinished = [target.with_name(f".{target.name}.{os.getpid()}.partial") for target in (path, beside)]
    try:
        with RecordingWriter(unfinished[0], scan.header) as writer:
            for view in scan.views:
                writer.write_view(view)
        unfinished[1].write_text(json.dumps(scan.truth, allow_nan=False))
        for source, target in zip(unfinished, (path, beside), strict=True):
            source.replace(target)
    finally:
        for source in unfinished:
            source.unlink(missing_ok=True)
    return beside
