"""Agreement of depth images with the table: it shows the depth unit, and poses that are inverted."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.geometry.transforms import inverse
from cell.frames.depth_file import measured
from cell.frames.errors import FramesError
from cell.frames.pose_files import PoseName

COUNT_UNITS_M = (0.01, 0.001, 0.0005, 0.00025, 0.0002, 0.0001, 1e-5, 1e-6)
"""Metres per count that depth cameras and data sets use."""
FLOAT_UNITS_M = (1.0, 0.001)
"""Floats are metres, rarely millimetres."""
TOLERANCE = 0.03
"""Relative error of a depth that counts as the table's: noise, and poses that are a few millimetres off."""
SURE_SHARE = 0.3
"""Share of the measured pixels that must lie on the table for a guess. A given unit with less is warned of."""
NEAR_M = 0.03
"""Pixels within this height of the table are looked at to measure where it is."""
PLANE_M = 0.015
"""Pixels within this height of a level plane count as on it, when the table is looked for at other heights."""
PLANE_SHARE = 0.6
"""Share of the measured pixels that must lie on such a plane. With a wrong unit, each image may have its own."""
SEARCH_M = 1.0
"""Largest distance of such a plane from the given height of the table."""
DEPTHS_M = (0.1, 3.0)
"""Range of the median depth for such a plane. With a much too small unit, all points are at the camera."""
SAMPLE = 10_000
"""Largest number of measured pixels of each image that are compared."""

Sample = tuple[float, NDArray[np.float64], NDArray[np.float64]]
"""Height of the camera, metres, and the rays and depths (N,) of up to `SAMPLE` measured pixels of an image. A ray is
the rise in the base frame per unit of depth."""


@dataclass(frozen=True, eq=False)
class Frames:
    """Depth images with their poses, before their unit is known."""

    values: Sequence[NDArray[np.generic]]
    """(H, W) each, in an unknown unit."""
    K: NDArray[np.float64]
    """(3, 3), pixels."""
    poses: Sequence[NDArray[np.float64]]
    """(4, 4) each, of the camera or the flange as `pose_name` says."""
    pose_name: PoseName
    T_pose_camera: NDArray[np.float64]
    """(4, 4) the hand-eye calibration, or the identity where the poses are the camera's."""
    names: Sequence[str]
    """File names of the images."""

    def T_base_camera(self, k: int) -> NDArray[np.float64]:
        """Return the camera pose of image `k`."""
        return self.poses[k] @ self.T_pose_camera

    def inverted(self) -> "Frames":
        """Return the same with each pose inverted."""
        poses = [inverse(T) for T in self.poses]
        return Frames(self.values, self.K, poses, self.pose_name, self.T_pose_camera, self.names)


def table_units(frames: Frames, table_z_m: float) -> NDArray[np.float64]:
    """Return the unit, metres, that would put each sampled pixel on the table; NaN where its ray meets no table."""
    found = []
    for camera_z_m, rays, values in _sampled(frames):
        with np.errstate(divide="ignore", invalid="ignore"):
            expected_m = (table_z_m - camera_z_m) / rays
            found.append(np.where(expected_m > 0, expected_m / values, np.nan))
    return np.concatenate(found)


def share_on_table(units: NDArray[np.float64], unit_m: float) -> float:
    """Return the share of the pixels that `unit_m` puts on the table, by the result of `table_units`."""
    with np.errstate(invalid="ignore"):
        return float(np.mean(np.abs(units / unit_m - 1) < TOLERANCE)) if len(units) else 0.0


def fitting_units(frames: Frames, units: NDArray[np.float64]) -> list[float]:
    """Return the common depth units that put the table where the poses say it is, by the result of `table_units`."""
    return [unit for unit in _common_units(frames) if share_on_table(units, unit) >= SURE_SHARE]


def table_offset_m(frames: Frames, table_z_m: float, unit_m: float) -> float | None:
    """Return how far the images show the table above `table_z_m`: the median over the pixels near it.

    Returns:
        Metres. If fewer than `SURE_SHARE` of the measured pixels are within `NEAR_M` of that height, the distance of
        another level plane; None if there is none.
    """
    samples = list(_sampled(frames))
    heights_m = _heights_m(samples, unit_m) - table_z_m
    near = np.abs(heights_m) < NEAR_M
    if near.mean() >= SURE_SHARE:
        return float(np.median(heights_m[near]))
    z_m = _level_plane_m(samples, table_z_m, unit_m)
    return None if z_m is None else z_m - table_z_m


def _heights_m(samples: Sequence[Sample], unit_m: float) -> NDArray[np.float64]:
    """Return the heights (N,) of all samples in the base frame."""
    return np.concatenate([camera_z_m + unit_m * values * rays for camera_z_m, rays, values in samples])


def _level_plane_m(samples: Sequence[Sample], table_z_m: float, unit_m: float) -> float | None:
    """Return the height of the level plane that most of the images show with a unit, metres; None if there is none.

    With a wrong unit, the table is at another height in each image. A single image may therefore show a plane with
    several units.
    """
    if not DEPTHS_M[0] <= unit_m * float(np.median(np.concatenate([values for *_, values in samples]))) <= DEPTHS_M[1]:
        return None
    heights_m = _heights_m(samples, unit_m)
    edges = np.arange(table_z_m - SEARCH_M, table_z_m + SEARCH_M + PLANE_M, PLANE_M)
    middle = edges[int(np.histogram(heights_m, edges)[0].argmax())] + PLANE_M / 2
    near = np.abs(heights_m - middle) < PLANE_M
    return float(np.median(heights_m[near])) if near.mean() >= PLANE_SHARE else None


def guess_unit(frames: Frames, table_z_m: float, units: NDArray[np.float64]) -> float:
    """Return the only common depth unit that puts the table where the poses say it is; floats are metres.

    Args:
        frames: The images and their poses.
        table_z_m: Height of the table in the base frame.
        units: Result of `table_units` for these.

    Returns:
        Metres per count, or per unit of floats.

    Raises:
        FramesError: No common unit does so, or several do.
    """
    fitting = fitting_units(frames, units)
    if len(fitting) > 1:
        shares = " and ".join(f"{unit:g} m ({share_on_table(units, unit):.0%} of the pixels)" for unit in fitting)
        raise FramesError(
            f"the depth unit is not given, and several put pixels at the table, z = {table_z_m:g} m: {shares}; give "
            "--depth-unit, metres per count, and check that all images have the same unit"
        )
    if fitting:
        return fitting[0]
    if frames.values[0].dtype.kind == "f":
        largest = max(float(values[measured(values)].max()) for values in frames.values)
        if largest <= 2 * 65.535:
            return 1.0
        raise FramesError(
            f"depths go up to {largest:g}, which metres cannot be, and millimetres do not put the table at z = "
            f"{table_z_m:g} m: give --depth-unit, metres per unit"
        )
    samples = list(_sampled(frames))
    planes = {unit: _level_plane_m(samples, table_z_m, unit) for unit in _common_units(frames)}
    level = [f"z = {z_m:.4f} m with {unit:g} m per count" for unit, z_m in planes.items() if z_m is not None]
    if level:
        raise FramesError(
            f"the depth unit is not given, and no common one puts the table at z = {table_z_m:g} m; the images show a "
            f"level plane at {' or at '.join(level)}: if this is the table, give --depth-unit, and --table-z as "
            "measured at the table, since errors of the poses move what the images show; if not, check the poses and "
            "the camera matrix"
        )
    usual = float(np.nanmedian(units)) if np.isfinite(units).any() else float("nan")
    would = f"; {usual:.3g} m per count would, but that is not a common unit" if np.isfinite(usual) else ""
    poses = "the poses"
    if frames.pose_name == "T_base_camera":
        poses += " (poses of the flange need --hand-eye)"
    raise FramesError(
        f"the depth unit is not given, and no common one puts the table at z = {table_z_m:g} m{would}: check "
        f"{poses}, the camera matrix and --table-z, and that depth is along the optical axis, not along the ray; or "
        "give --depth-unit, metres per count"
    )


def check_poses(frames: Frames, table_z_m: float, unit_m: float | None, units: NDArray[np.float64]) -> None:
    """Refuse poses that are inverted, or that put the camera below the table or let it look away from it.

    Args:
        frames: The images and their poses.
        table_z_m: Height of the table in the base frame.
        unit_m: Metres per depth unit; None: not known.
        units: Result of `table_units` for these.

    Raises:
        FramesError: The poses cannot be those of a camera that sees the table.
    """
    fault = _fault(frames, table_z_m)
    inverted = frames.inverted()
    candidates = _common_units(frames) if unit_m is None else (unit_m,)
    given_share, inverted_share = (
        max(share_on_table(each, unit) for unit in candidates) for each in (units, table_units(inverted, table_z_m))
    )
    table_only_inverted = inverted_share >= max(SURE_SHARE, 2 * given_share)
    if _fault(inverted, table_z_m) is None and (fault is not None or table_only_inverted):
        name = frames.pose_name
        turned = "T_" + "_".join(reversed(name.removeprefix("T_").split("_")))
        why = fault or "with these poses the depth images show no table, and with their inverses they do"
        raise FramesError(f"{why}: these look like {turned}; invert them, {name} is needed")
    if fault is not None:
        raise FramesError(
            f"{fault}: check the order of quaternions (x, y, z, w), the camera axes (x right, y down, z forward) and "
            "--table-z; z of the base frame must point up"
        )


def _sampled(frames: Frames) -> Iterator[Sample]:
    """Yield the sample of each image."""
    rng = np.random.default_rng(0)  # a fixed stride would miss a pattern of the same period
    for k, values in enumerate(frames.values):
        rows, columns = np.nonzero(measured(values))
        if len(rows) > SAMPLE:
            chosen = rng.choice(len(rows), SAMPLE, replace=False)
            rows, columns = rows[chosen], columns[chosen]
        T = frames.T_base_camera(k)
        rays = np.column_stack([columns, rows, np.ones(len(rows))]) @ (T[2, :3] @ np.linalg.inv(frames.K))
        yield float(T[2, 3]), rays, values[rows, columns].astype(np.float64)


def _common_units(frames: Frames) -> tuple[float, ...]:
    return FLOAT_UNITS_M if frames.values[0].dtype.kind == "f" else COUNT_UNITS_M


def _fault(frames: Frames, table_z_m: float) -> str | None:
    """Return what is impossible about the first such camera pose, or None."""
    for k, values in enumerate(frames.values):
        T = frames.T_base_camera(k)
        if T[2, 3] <= table_z_m:
            return f"the pose of {frames.names[k]} puts the camera at z = {T[2, 3]:.3f} m, below the table"
        height, width = values.shape
        corners = np.array([(u, v, 1.0) for u in (0, width - 1) for v in (0, height - 1)])
        if not (corners @ (T[2, :3] @ np.linalg.inv(frames.K)) < 0).any():
            return f"by the pose of {frames.names[k]} the camera looks away from the table"
    return None
