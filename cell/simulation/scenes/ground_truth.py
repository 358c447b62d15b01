"""The exact truth of a simulated scan, as it is written beside the recording."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cell.simulation.scenes.planar_crossings import at, plan_crossings
from cell.simulation.scenes.scenes import StringScene
from recognition.geometry.polyline import arc_length, points_at

STEP_M = 0.002
"""Distance of the points of the written curves."""


def scene_truth(
    scene: StringScene, T_base_camera: Sequence[NDArray[np.float64]], T_flange_camera: NDArray[np.float64]
) -> dict[str, Any]:
    """The truth as JSON: metres, base frame.

    `curves` are the centre lines, every 2 mm, and `closed` tells of each whether it is a ring (its last point is then
    its first); `radii` has each string's radius and `radius` the first's; `crossings` have a `point` between the
    strands, and `over` and `under` as [string, arc length]; `T_base_camera` are the true camera poses of the views and
    `T_flange_camera` the true mounting.
    """
    return {
        "name": scene.name,
        "radius": scene.radius_m,
        "radii": list(scene.radii_m),
        "closed": list(scene.closed),
        "curves": [_every(curve, STEP_M).round(7).tolist() for curve in scene.curves],
        "crossings": true_crossings(scene),
        "T_base_camera": [T.tolist() for T in T_base_camera],
        "T_flange_camera": T_flange_camera.tolist(),
    }


def true_crossings(scene: StringScene) -> list[dict[str, Any]]:
    """The crossings of a scene's centre lines seen from above, over and under by their heights there."""
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
    """`curve` (N, 3) at steps of about `step_m`, both ends kept."""
    length_m = arc_length(curve)[-1]
    even = np.linspace(0.0, length_m, max(round(length_m / step_m), 1) + 1)
    return points_at(curve, even)
