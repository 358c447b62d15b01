"""Objects on the table that are not strings."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Box:
    """A box that stands on the table."""

    centre_m: tuple[float, float]
    """Position (x, y) of its centre."""
    size_m: tuple[float, float, float]
    """Width, depth and height."""
    yaw_rad: float
    """Angle of the width's direction from the x axis."""


@dataclass(frozen=True)
class Clump:
    """A rough heap, like a hand at rest or a crumpled cloth in a depth image."""

    centre_m: tuple[float, float]
    radius_m: float
    height_m: float
    seed: int
    """Seed of its surface."""


@dataclass(frozen=True)
class Rod:
    """A straight round bar with flat ends: a pen on the table, or a post."""

    start_m: tuple[float, float, float]
    """Start (x, y, z) of its axis."""
    end_m: tuple[float, float, float]
    """End (x, y, z) of its axis."""
    radius_m: float


@dataclass(frozen=True, eq=False)
class Cloth:
    """A thin cloth on the table with folds, whose sides pass smoothly into the cloth."""

    centre_m: tuple[float, float]
    """Position (x, y) of its centre."""
    half_m: float
    """Half of the side length of the square cloth."""
    thickness_m: float
    folds: tuple[NDArray[np.float64], ...]
    """Ridge (N, 2) of each fold, seen from above."""
    fold_height_m: float
    """Height of the folds above the cloth."""
    fold_width_m: float
    """Standard deviation of the cross-section of a fold, which is a bell curve."""


def fixture_edge(rng: np.random.Generator) -> Box:
    """Return the edge of a fixture, which is long, straight and 3 to 15 mm high."""
    bearing = rng.uniform(0, 2 * np.pi)
    distance = rng.uniform(0.0, 0.08)
    return Box(
        (float(distance * np.cos(bearing)), float(distance * np.sin(bearing))),
        (float(rng.uniform(0.20, 0.35)), float(rng.uniform(0.004, 0.04)), float(rng.uniform(0.003, 0.015))),
        float(rng.uniform(0, np.pi)),
    )


def place_clump(rng: np.random.Generator, boxes: Sequence[Box]) -> Clump | None:
    """Return a clump of the size of a hand beside the boxes, or None without room."""
    for _ in range(400):
        bearing, distance = rng.uniform(0, 2 * np.pi), rng.uniform(0.05, 0.18)
        clump = Clump(
            (float(distance * np.cos(bearing)), float(distance * np.sin(bearing))),
            float(rng.uniform(0.035, 0.055)),
            float(rng.uniform(0.02, 0.045)),
            int(rng.integers(2**31)),
        )
        if all(distance_to_box(np.array([clump.centre_m]), box)[0] > clump.radius_m + 0.005 for box in boxes):
            return clump
    return None


def place_boxes(
    rng: np.random.Generator,
    curves: Sequence[NDArray[np.float64]],
    radius_m: float,
    count: int,
    standing: Sequence[Box] = (),
) -> tuple[Box, ...] | None:
    """Return boxes of 2 to 5 cm beside the strings, or None without room.

    They are at least 5 mm away from the strings and from each other.

    Args:
        rng: Generator of the boxes.
        curves: Centre lines (N, 3) of the strings.
        radius_m: Radius of the strings.
        count: Number of new boxes.
        standing: Boxes that exist already. They come first in the result.
    """
    line = np.vstack([curve[:, :2] for curve in curves]) if curves else np.zeros((0, 2))
    extent = (float(np.linalg.norm(line, axis=1).max()) if curves else 0.1) + 0.06
    boxes: list[Box] = list(standing)
    count += len(boxes)
    for _ in range(400 * count):
        if len(boxes) == count:
            break
        angle, distance = rng.uniform(0, 2 * np.pi), extent * np.sqrt(rng.random())
        box = Box(
            (float(distance * np.cos(angle)), float(distance * np.sin(angle))),
            (float(rng.uniform(0.02, 0.05)), float(rng.uniform(0.02, 0.05)), float(rng.uniform(0.01, 0.04))),
            float(rng.uniform(0, np.pi)),
        )
        if distance_to_box(line, box).min(initial=np.inf) < radius_m + 0.005:
            continue
        outline = footprint(box)
        if all(distance_to_box(outline, other).min() > 0.005 for other in boxes):
            boxes.append(box)
    return tuple(boxes) if len(boxes) == count else None


def distance_to_box(points: NDArray[np.float64], box: Box) -> NDArray[np.float64]:
    """Return the distances (N,) of points (N, 2) on the table from the footprint of a box, 0 inside."""
    c, s = np.cos(box.yaw_rad), np.sin(box.yaw_rad)
    local = (points - box.centre_m) @ np.array([[c, -s], [s, c]])
    return np.linalg.norm(np.maximum(np.abs(local) - np.array(box.size_m[:2]) / 2, 0.0), axis=1)


def footprint(box: Box) -> NDArray[np.float64]:
    """Return points (81, 2) on the footprint of a box, dense enough that no other box fits between them."""
    x, y = np.meshgrid(np.linspace(-0.5, 0.5, 9) * box.size_m[0], np.linspace(-0.5, 0.5, 9) * box.size_m[1])
    c, s = np.cos(box.yaw_rad), np.sin(box.yaw_rad)
    return np.column_stack([x.ravel(), y.ravel()]) @ np.array([[c, s], [-s, c]]) + box.centre_m
