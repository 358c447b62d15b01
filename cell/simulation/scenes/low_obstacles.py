"""Low objects beside or under a string: bars, plates, posts, slots and walls.

Objects beside a string have an exact free distance from it, seen from above. The heights of a string on a plate follow
from the height of the support under each of its points.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from cell.simulation.scenes.clutter import Box, distance_to_box, footprint
from cell.simulation.scenes.shapes import STEP_M
from recognition.geometry.polyline import resample

KINDS = ("bar", "plate", "post", "slot", "wall")
"""Names of the scenes with low objects."""
FREE_M = (0.002, 0.010)
"""Smallest and largest free distance of an object from the nearest string, seen from above."""
LOW_M = (0.0015, 0.010)
"""Smallest and largest height of bars and plates."""
POST_M = (0.002, 0.060)
"""Smallest and largest height of posts."""
APART_M = 0.003
"""Smallest distance between two objects."""

_TRIES = 60
"""Number of positions that are tried for one object."""
_MAX_SHIFT_M = 0.008
"""Largest distance by which an object is moved away from its position beside the string, because the string bends."""
_FINE_M = STEP_M / 4
"""Step of the centre lines from which distances are measured. It adds at most 2 micrometres to a distance."""


def kind_of(scene_name: str) -> str | None:
    """Return the kind of a scene by its name, such as `bar-7`. None: it has no low objects."""
    kind = scene_name.rpartition("-")[0]
    return kind if kind in KINDS else None


def draw_plate(rng: np.random.Generator, plan: Sequence[NDArray[np.float64]]) -> Box:
    """Return a plate under a part of the strings, or under all of them.

    Args:
        rng: Generator of the plate.
        plan: Courses (N, 2) of the strings.
    """
    line = np.vstack([curve[:, :2] for curve in plan])
    height_m = _height(rng, LOW_M)
    if rng.random() < 0.4:
        yaw = float(rng.uniform(0, np.pi))
        local = _local(line, (0.0, 0.0), yaw)
        margins_m = rng.uniform(0.006, 0.03, (2, 2))
        low, high = local.min(axis=0) - margins_m[0], local.max(axis=0) + margins_m[1]
        centre = _rotation(yaw) @ (low + high) / 2
        return Box(_pair(centre), (float(high[0] - low[0]), float(high[1] - low[1]), height_m), yaw)
    curve = plan[int(rng.integers(len(plan)))]
    k, tangent = _position(rng, curve, 0.1)
    yaw = float(np.arctan2(tangent[1], tangent[0]) + rng.uniform(-0.6, 0.6))
    size = (float(rng.uniform(0.04, 0.12)), float(rng.uniform(0.03, 0.10)), height_m)
    offset = _rotation(yaw) @ (rng.uniform(-0.3, 0.3, 2) * size[:2])
    return Box(_pair(curve[k, :2] + offset), size, yaw)


def support_heights(points: NDArray[np.float64], radius_m: float, plates: Sequence[Box]) -> NDArray[np.float64]:
    """Return the smallest heights (N,) of a centre line over the table and plates.

    A string of this radius just touches the table or the nearest edge or face of a plate.

    Args:
        points: Points (N, 2) of the centre line, seen from above.
        radius_m: Radius of the string.
        plates: Boxes that support the string.
    """
    lowest = np.full(len(points), radius_m)
    for plate in plates:
        # half a step nearer, so that the string does not cut the edge between two of its points
        beside = np.maximum(distance_to_box(points, plate) - STEP_M / 2, 0.0)
        over = plate.size_m[2] + np.sqrt(np.maximum(radius_m**2 - beside**2, 0.0))
        lowest = np.where(beside < radius_m, np.maximum(lowest, over), lowest)
    return lowest


def place_low_objects(
    rng: np.random.Generator, kind: str, curves: Sequence[NDArray[np.float64]], radius_m: float
) -> tuple[Box, ...] | None:
    """Return objects beside the strings, or None without room.

    - `bar`: one to three bars, 1.5 to 10 mm high, parallel to the string.
    - `post`: four to eight posts, 4 to 10 mm wide and 2 to 60 mm high.
    - `slot`: one or two pairs of parallel bars, to the left and to the right of the string.
    - `wall`: one or two walls, 2 to 6 mm thick and 20 to 60 mm high, parallel to the string.

    Each object has a free distance of `FREE_M` from the nearest string, seen from above.

    Args:
        rng: Generator of the objects.
        kind: One of `KINDS`, but not `plate`.
        curves: Centre lines (N, 3) of the strings.
        radius_m: Radius of the strings.
    """
    lines = [resample(curve[:, :2], _FINE_M) for curve in curves]
    most = {"bar": 3, "post": 8, "slot": 2, "wall": 2}[kind]
    wanted = int(rng.integers(4 if kind == "post" else 1, most + 1))
    groups: list[tuple[Box, ...]] = []
    for _ in range(_TRIES * wanted):
        if len(groups) == wanted:
            break
        group = _draw(rng, kind, lines, radius_m)
        placed = [box for other in groups for box in other]
        if group is not None and all(_boxes_apart(box, other) for box in group for other in placed):
            groups.append(group)
    return tuple(box for group in groups for box in group) or None


def free_distance_m(curves: Sequence[NDArray[np.float64]], radius_m: float, box: Box) -> float:
    """Return the free distance between the nearest string and a box, seen from above. Negative: they overlap."""
    line = np.vstack([resample(curve[:, :2], _FINE_M) for curve in curves])
    return float(distance_to_box(line, box).min()) - radius_m


def _draw(
    rng: np.random.Generator, kind: str, lines: Sequence[NDArray[np.float64]], radius_m: float
) -> tuple[Box, ...] | None:
    """Return one object, or the two bars of a slot, at a random position along a string. None if it does not fit."""
    k, tangent = _position(rng, lines[0], 0.02)
    point, heading = lines[0][k], float(np.arctan2(tangent[1], tangent[0]))
    side = int(rng.choice([-1, 1]))
    match kind:
        case "bar":
            sizes = [(float(rng.uniform(0.03, 0.10)), float(rng.uniform(0.004, 0.015)), _height(rng, LOW_M))]
        case "slot":
            length_m = float(rng.uniform(0.025, 0.08))
            sizes = [(length_m, float(rng.uniform(0.004, 0.015)), _height(rng, LOW_M)) for _ in range(2)]
        case "wall":
            sizes = [(float(rng.uniform(0.03, 0.10)), float(rng.uniform(0.002, 0.006)), float(rng.uniform(0.02, 0.06)))]
        case _:
            width_m, depth_m = rng.uniform(0.004, 0.010, 2)
            sizes = [(float(width_m), float(depth_m), _height(rng, POST_M))]
            heading += float(rng.uniform(0, np.pi))
    boxes = []
    for size, sign in zip(sizes, (side, -side), strict=False):
        normal = sign * np.array([-tangent[1], tangent[0]])
        box = _beside(lines, radius_m, point, normal, size, heading, float(rng.uniform(*FREE_M)))
        if box is None:
            return None
        boxes.append(box)
    return tuple(boxes)


def _beside(
    lines: Sequence[NDArray[np.float64]],
    radius_m: float,
    point: NDArray[np.float64],
    normal: NDArray[np.float64],
    size_m: tuple[float, float, float],
    yaw_rad: float,
    free_m: float,
) -> Box | None:
    """Return the box that is shifted along `normal` from `point` until it has the free distance, or None."""
    line = np.vstack(list(lines))
    line = line[np.linalg.norm(line - point, axis=1) < np.hypot(*size_m[:2]) + 0.05]
    half = 0.5 * float(np.abs(_rotation(yaw_rad).T @ normal) @ np.array(size_m[:2]))

    def box_at(shift_m: float) -> Box:
        return Box(_pair(point + (radius_m + free_m + half + shift_m) * normal), size_m, yaw_rad)

    def free_at(shift_m: float) -> float:
        return float(distance_to_box(line, box_at(shift_m)).min()) - radius_m

    low, high = 0.0, _MAX_SHIFT_M
    if free_at(low) < free_m:
        # the string bends towards the box: the shift at which the distance is right is in between
        if free_at(high) < free_m:
            return None
        for _ in range(40):
            middle = (low + high) / 2
            low, high = (middle, high) if free_at(middle) < free_m else (low, middle)
    else:
        high = low
    # beside another strand, or across the string, the distance may be right although the box is on the wrong side
    free = float(distance_to_box(np.vstack(list(lines)), box_at(high)).min()) - radius_m
    return box_at(high) if abs(free - free_m) < 1e-6 else None


def _position(rng: np.random.Generator, curve: NDArray[np.float64], margin: float) -> tuple[int, NDArray[np.float64]]:
    """Return the index of a random point of a curve and its direction (2,), away from the ends by a share."""
    k = int(rng.uniform(margin, 1 - margin) * (len(curve) - 1))
    before, after = max(k - 3, 0), min(k + 3, len(curve) - 1)
    along = curve[after, :2] - curve[before, :2]
    return k, along / np.linalg.norm(along)


def _height(rng: np.random.Generator, range_m: tuple[float, float]) -> float:
    """Return a height. Its logarithm is uniform, so that low heights are frequent."""
    return float(np.exp(rng.uniform(*np.log(range_m))))


def _boxes_apart(box: Box, other: Box) -> bool:
    between = min(distance_to_box(footprint(a), b).min() for a, b in ((box, other), (other, box)))
    return bool(between > APART_M)


def _rotation(yaw_rad: float) -> NDArray[np.float64]:
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    return np.array([[c, -s], [s, c]])


def _local(points: NDArray[np.float64], centre: tuple[float, float], yaw_rad: float) -> NDArray[np.float64]:
    """Return points (N, 2) in the frame of a box."""
    return (points - np.array(centre)) @ _rotation(yaw_rad)


def _pair(point: NDArray[np.float64]) -> tuple[float, float]:
    return float(point[0]), float(point[1])
