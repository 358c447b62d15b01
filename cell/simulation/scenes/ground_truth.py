"""Truth of a simulated scan, which is written beside the recording."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibration.geometry.transforms import transform_points
from cell.simulation.scenes.planar_crossings import at, plan_crossings
from cell.simulation.scenes.scenes import StringScene
from recognition.geometry.polyline import arc_length, points_at

STEP_M = 0.002
"""Distance of the points of the written curves."""


def scene_truth(
    scene: StringScene,
    T_base_camera: Sequence[NDArray[np.float64]],
    T_flange_camera: NDArray[np.float64],
    T_base_table: NDArray[np.float64] | None = None,
) -> dict[str, Any]:
    """Return the truth as JSON, in metres and in the base frame.

    `curves` are the centre lines with a point every 2 mm, `closed` says which are rings, `radii` are the radii, and
    `radius` is that of the first string. Each of `crossings` has a `point` between the strands, and `over` and `under`
    as string and arc length. `T_base_camera` are the true camera poses, and `T_flange_camera` is the true mounting.

    Args:
        scene: Strings on the table.
        T_base_camera: True camera poses (4, 4).
        T_flange_camera: True mounting of the camera (4, 4).
        T_base_table: True pose (4, 4) of the table with the scene on it. None means the base frame.
    """
    T_base_table = np.eye(4) if T_base_table is None else T_base_table
    crossings = true_crossings(scene)
    for crossing in crossings:
        crossing["point"] = transform_points(T_base_table, np.array([crossing["point"]]))[0].tolist()
    return {
        "name": scene.name,
        "radius": scene.radius_m,
        "radii": list(scene.radii_m),
        "closed": list(scene.closed),
        "curves": [transform_points(T_base_table, _every(curve, STEP_M)).round(7).tolist() for curve in scene.curves],
        "crossings": crossings,
        "T_base_camera": [T.tolist() for T in T_base_camera],
        "T_flange_camera": T_flange_camera.tolist(),
    }


def true_crossings(scene: StringScene) -> list[dict[str, Any]]:
    """Return the crossings of a scene seen from above, with over and under by their heights."""
    lengths = [arc_length(curve) for curve in scene.curves]
    result = []
    for crossing in plan_crossings(scene.curves):
        strands = sorted(
            (crossing.first, crossing.second), key=lambda strand: -at(scene.curves[strand[0]], strand[1])[2]
        )
        (over, s_over), (under, s_under) = (
            (string, float(at(lengths[string][:, None], position)[0])) for string, position in strands
        )
        middle = (at(scene.curves[over], strands[0][1]) + at(scene.curves[under], strands[1][1])) / 2
        result.append({"point": middle.tolist(), "over": [over, s_over], "under": [under, s_under]})
    return result


def _every(curve: NDArray[np.float64], step_m: float) -> NDArray[np.float64]:
    """Return `curve` (N, 3) in steps of about `step_m`, with both ends."""
    length_m = arc_length(curve)[-1]
    even = np.linspace(0.0, length_m, max(round(length_m / step_m), 1) + 1)
    return points_at(curve, even)
