"""Find the simulated stereo camera that has the errors of a measured one.

Focal length, baseline and warp follow from the measured table. The matching window and the texture of the table are
those whose simulated table is most like the measured one.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from cell.camera_profile.depth_profile import (
    ERRORS_M,
    QUANTITY_NAMES,
    DepthProfile,
    ProfileError,
    format_quantity,
    to_document,
)
from cell.camera_profile.measure import Measurement, PoseImages, measure_profile
from cell.config.camera_optics import STEREO_BASELINES_M
from cell.config.camera_preset import DISPARITY_STEP, CameraPreset, Source, StereoName
from cell.config.rendering_options import TABLE_TOPS, RenderingOptions
from cell.simulation.profiling.table_view import TableStills, TableViewing, still_tables
from cell.simulation.rendering.depth_camera import CAMERAS, CameraModel
from cell.simulation.rendering.stereo_camera import StereoPair, slow_field

BLOCKS_PX = 3, 25
"""Smallest and largest side of the matching window that is tried."""
MAX_MISSES = 2
"""Number of windows in a row that are no better, after which no larger or smaller one is tried."""
FIRST_BLOCK_PX = 5
"""Side of the matching window with which the table tops are compared first."""
WORTH_FACTOR = 6.0
"""Largest ratio of the difference of a table top to that of the best one, with which all windows are compared."""
MAX_POSES = 2
"""Largest number of poses that are simulated for each comparison."""
MAX_IMAGES = 5
"""Largest number of images per pose that are simulated."""
TOLERANCES = {
    "temporal_m": 0.25,
    "ripple_m": 0.10,
    "locking_m": 0.15,
    "rest_m": 0.15,
    "correlation_px": 0.10,
    "correlation_rows_px": 0.10,
}
"""Relative differences that weigh as much as one another in the comparison."""
MIN_ERROR_PX = 0.02
"""Smallest depth error that counts, pixels of disparity. Smaller ones are alike."""
NOISE_FACTORS = 0.2, 8.0
"""Smallest and largest noise of the image sensors."""
NOISE_STEPS = 2
"""Number of steps in which the noise of the image sensors is found."""
SAME_SHARE = 0.05
"""Largest relative difference of the products of focal length and baseline with which the search range is the same."""
WARP_DRAWS = 20
"""Number of random warps from which the visible share of a warp is computed."""
UNLIKE = 1.5
"""Factor between a measured error and the simulated one that is reported."""
REPRODUCED = (*TOLERANCES, "warp_m")
"""Quantities of which the report says if the simulated camera does not have them."""
FIXED = {
    "bias_px": "a shift of all disparities looks like an error of the table's height",
    "row_error_px": "a row error hardly changes the depth of a table",
    "matching": "smoothness, uniqueness, left-right check and contrast limit are known to the device only",
}
"""Parameters that a table does not show, with the reason."""


@dataclass(frozen=True)
class FitOptions:
    """How a camera is found."""

    base: StereoName | None = None
    """Simulated camera whose parameters hold where nothing is measured, or None for the most similar one."""
    is_median: bool = True
    """Whether each image is the median of several exposures, as in a recording."""
    seed: int = 0
    """Seed of the simulated tables."""


@dataclass(frozen=True, eq=False)
class _Candidate:
    """A simulated camera and its profile."""

    stills: TableStills
    """What the camera sees of the table."""
    profile: DepthProfile
    """Profile of the camera."""
    score: float
    """Mean squared difference from the measured profile, in tolerances."""

    @property
    def pair(self) -> StereoPair:
        """Cameras and matching."""
        pair = self.stills.camera.model.stereo
        assert pair is not None
        return pair


def fit_camera(poses: Sequence[PoseImages], options: FitOptions) -> CameraPreset:
    """Return the parameters of the simulated stereo camera that measures a table like the given images.

    Args:
        poses: Images of the table from one or several poses.
        options: How the camera is found.

    Raises:
        ProfileError: No table is in view, or the depth is not matched in windows.
    """
    measurement = measure_profile(poses)
    measured = measurement.profile
    _require_windows(measured, options.base)
    base = options.base or nearest_base(measured)
    start = _start(base, measured, poses)
    best = _best_candidate(start, measurement, options)
    sources = _sources(measured)
    return _preset(base, best, measured, sources)


def nearest_base(measured: DepthProfile) -> StereoName:
    """Return the simulated camera with the most similar field of view and the most similar baseline."""

    def difference(name: StereoName) -> float:
        model = CAMERAS[name]
        angle = abs(math.log(measured.focal_px / measured.width * model.width / model.focal_px))
        if measured.focal_baseline_px_m is None:
            return angle
        baseline_m = measured.focal_baseline_px_m / measured.focal_px
        return angle + abs(math.log(baseline_m / STEREO_BASELINES_M[name]))

    names: tuple[StereoName, ...] = ("oak-d-pro", "oak-d-sr", "d435")
    return min(names, key=difference)


def _require_windows(measured: DepthProfile, base: StereoName | None) -> None:
    """Raise ProfileError if the table shows no sign of matching windows and no camera is named."""
    if measured.locking_m > 0 or base is not None:
        return
    raise ProfileError(
        "the table shows no pixel locking, so neither the baseline nor the matching window can be measured: the table "
        "has too little texture, the depth is coarse or filtered, or it is not matched in windows of two images, as "
        "that of the simulated camera ideal; give the table texture or dots, or name a similar camera with --like"
    )


def _start(base: StereoName, measured: DepthProfile, poses: Sequence[PoseImages]) -> CameraModel:
    """Return the simulated camera with the geometry and the warp of the measured one."""
    model = CAMERAS[base]
    pair = model.stereo
    assert pair is not None
    baseline_m = pair.baseline_m
    if measured.locking_m > 0 and measured.focal_baseline_px_m is not None:
        baseline_m = measured.focal_baseline_px_m / measured.focal_px
    focal_baseline = measured.focal_px * baseline_m
    warp_px = measured.warp_m * focal_baseline / measured.distance_m**2
    disparities = pair.disparities
    if abs(focal_baseline / (model.focal_px * pair.baseline_m) - 1) > SAME_SHARE:
        disparities = DISPARITY_STEP * max(math.ceil(focal_baseline / model.near_m / DISPARITY_STEP), 1)
    size = (measured.height, measured.width)
    return replace(
        model,
        focal_px=measured.focal_px,
        width=measured.width,
        height=measured.height,
        depth_unit_m=poses[0].depth_unit_m,
        stereo=replace(
            pair,
            baseline_m=baseline_m,
            disparities=disparities,
            warp_px=warp_px / visible_warp_share(size),
        ),
    )


def visible_warp_share(shape: tuple[int, int]) -> float:
    """Return the mean share of a warp that is no tilt of the table: its root mean square without the linear part."""
    height, width = shape
    step = max(min(shape) // 50, 1)
    v, u = np.mgrid[:height:step, :width:step].reshape(2, -1)
    A = np.column_stack([u / width, v / height, np.ones(len(u))])
    shares = []
    for seed in range(WARP_DRAWS):
        warp = slow_field(shape, 1.0, np.random.default_rng(seed))[v, u].astype(np.float64)
        rest = warp - A @ np.linalg.lstsq(A, warp, rcond=None)[0]
        shares.append(float(np.sqrt(np.mean(rest**2) / np.mean(warp**2))))
    return float(np.mean(shares))


def _best_candidate(start: CameraModel, measurement: Measurement, options: FitOptions) -> _Candidate:
    """Return the most similar camera of all windows and table tops."""
    measured = measurement.profile
    viewing = TableViewing(
        RenderingOptions(), options.seed, min(measured.exposures, MAX_IMAGES), is_median=options.is_median
    )
    tables = measurement.tables[:MAX_POSES]
    first = []
    for table_top in TABLE_TOPS:
        stills = still_tables(replace(start, table_top=table_top), tables, viewing)
        candidate = _candidate(_with_block(stills, FIRST_BLOCK_PX), measured)
        if candidate is not None:
            first.append(candidate)
    if not first:
        raise ProfileError(
            "a simulated camera sees no table as in these images: name a similar camera with --like, and check the "
            "camera matrix of the recording"
        )
    limit = WORTH_FACTOR * min(candidate.score for candidate in first)
    finished = [_best_of_top(candidate, measured) for candidate in first if candidate.score <= limit]
    return min(finished, key=lambda candidate: candidate.score)


def _best_of_top(first: _Candidate, measured: DepthProfile) -> _Candidate:
    """Return the most similar camera with the table top of a first one."""
    best = first
    if measured.locking_m == 0:  # nothing shows the window
        return _with_noise(best, measured)
    smallest, largest = BLOCKS_PX
    for windows in (range(FIRST_BLOCK_PX + 2, largest + 1, 2), range(FIRST_BLOCK_PX - 2, smallest - 1, -2)):
        misses = 0
        for block_px in windows:
            candidate = _candidate(_with_block(first.stills, block_px), measured)
            is_better = candidate is not None and candidate.score < best.score
            best = candidate if candidate is not None and is_better else best
            misses = 0 if is_better else misses + 1
            if misses == MAX_MISSES:
                break
    return _with_noise(best, measured)


def _with_noise(candidate: _Candidate, measured: DepthProfile) -> _Candidate:
    """Return the camera with the noise of the image sensors that gives the measured temporal noise, if it is known."""
    low, high = NOISE_FACTORS
    for _ in range(NOISE_STEPS):
        simulated_m = candidate.profile.value_at("temporal_m", measured.distance_m)
        if not measured.temporal_m or not simulated_m:
            break
        pair = candidate.pair
        factor = min(max(pair.noise_factor * measured.temporal_m / simulated_m, low), high)
        changed = _candidate(candidate.stills.with_matching(pair.matching, factor), measured)
        if changed is None or changed.score >= candidate.score:
            break
        candidate = changed
    return candidate


def _with_block(stills: TableStills, block_px: int) -> TableStills:
    """Return the view of a table with another matching window."""
    pair = stills.camera.model.stereo
    assert pair is not None
    return stills.with_matching(replace(pair.matching, block_px=block_px), pair.noise_factor)


def _candidate(stills: TableStills, measured: DepthProfile) -> _Candidate | None:
    """Return a simulated camera with its profile, or None if it sees no table."""
    model = stills.camera.model
    assert model.stereo is not None
    focal_baseline_px_m = model.focal_px * model.stereo.baseline_m
    try:
        profile = measure_profile(stills.images(), focal_baseline_px_m).profile
    except ProfileError:
        return None
    return _Candidate(stills, profile, _difference(measured, profile, focal_baseline_px_m))


def _difference(measured: DepthProfile, simulated: DepthProfile, focal_baseline_px_m: float) -> float:
    """Return the mean squared logarithm of the ratio of all errors that both profiles have, in tolerances."""
    min_error_m = MIN_ERROR_PX * measured.distance_m**2 / focal_baseline_px_m
    squares = []
    for name, tolerance in TOLERANCES.items():
        one = getattr(measured, name)
        other = simulated.value_at(name, measured.distance_m)
        if one is None or other is None:
            continue
        if name in ERRORS_M:
            one = max(one, min_error_m)
            other = max(other, min_error_m)
        squares.append((math.log(one / other) / tolerance) ** 2)
    return float(np.mean(squares))


def _sources(measured: DepthProfile) -> dict[str, Source]:
    """Return whether each parameter is measured."""
    has_locking: Source = "measured" if measured.locking_m > 0 else "default"
    has_images: Source = "measured" if measured.temporal_m is not None else "default"
    return {
        "focal_px": "measured",
        "baseline_m": has_locking,
        "block_px": has_locking,
        "warp_px": "measured",
        "table_top": "measured",
        "noise_factor": has_images,
        "row_error_px": "default",
        "bias_px": "default",
        "near_m": "default",
        "working_m": "default",
        "disparities": "default",
    }


def _preset(base: StereoName, best: _Candidate, measured: DepthProfile, sources: dict[str, Source]) -> CameraPreset:
    """Return the parameters of a camera, with what was measured and what is left."""
    model = best.stills.camera.model
    pair = best.pair
    return CameraPreset(
        base=base,
        width=model.width,
        height=model.height,
        focal_px=model.focal_px,
        depth_unit_m=model.depth_unit_m,
        near_m=model.near_m,
        working_m=model.working_m,
        baseline_m=pair.baseline_m,
        disparities=pair.disparities,
        block_px=pair.matching.block_px,
        warp_px=pair.warp_px,
        row_error_px=pair.row_error_px,
        bias_px=pair.bias_px,
        noise_factor=pair.noise_factor,
        table_top=model.table_top,
        sources=sources,
        notes=tuple(_notes(base, best.profile, measured)),
        measured=to_document(measured),
        reproduced=to_document(best.profile),
    )


def _notes(base: StereoName, simulated: DepthProfile, measured: DepthProfile) -> list[str]:
    """Return messages about what was not measured or is not reproduced."""
    notes = [f"{name} is that of {base}: {reason}" for name, reason in FIXED.items()]
    if measured.locking_m == 0:
        notes.append(f"baseline_m and block_px are those of {base}: the table shows no pixel locking")
    if measured.temporal_m is None:
        notes.append(
            f"noise_factor is that of {base}: there is one image per pose; it needs several images of one pose"
        )
    for name in REPRODUCED:
        one = getattr(measured, name)
        other = simulated.value_at(name, measured.distance_m)
        if one is None or other is None:
            continue
        if max(one, other) > UNLIKE * min(one, other):
            values = f"{format_quantity(name, one)} measured, {format_quantity(name, other)} simulated"
            notes.append(f"the {QUANTITY_NAMES[name]} is not reproduced: {values}")
    return notes
