"""Boxes that stand about on the table."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Box:
    """A box that stands on the table."""

    centre_m: tuple[float, float]
    """x and y of its middle."""
    size_m: tuple[float, float, float]
    """Width, depth and height."""
    yaw_rad: float
    """Its width's direction, from the x axis."""


def place_boxes(
    rng: np.random.Generator, curves: Sequence[NDArray[np.float64]], radius_m: float, count: int
) -> tuple[Box, ...] | None:
    """`count` boxes of 2 to 5 cm beside the strings, at least 5 mm clear of them and of each other; None: no room."""
    line = np.vstack([curve[:, :2] for curve in curves])
    extent = float(np.linalg.norm(line, axis=1).max()) + 0.06
    boxes: list[Box] = []
    for _ in range(400 * count):
        if len(boxes) == count:
            break
        angle, distance = rng.uniform(0, 2 * np.pi), extent * np.sqrt(rng.random())
        box = Box(
            (float(distance * np.cos(angle)), float(distance * np.sin(angle))),
            (float(rng.uniform(0.02, 0.05)), float(rng.uniform(0.02, 0.05)), float(rng.uniform(0.01, 0.04))),
            float(rng.uniform(0, np.pi)),
        )
        if distance_to_box(line, box).min() < radius_m + 0.005:
            continue
        outline = _outline(box)
        if all(distance_to_box(outline, other).min() > 0.005 for other in boxes):
            boxes.append(box)
    return tuple(boxes) if len(boxes) == count else None


def distance_to_box(points: NDArray[np.float64], box: Box) -> NDArray[np.float64]:
    """(N,) distances on the table of `points` (N, 2) from the box's footprint, 0 inside."""
    c, s = np.cos(box.yaw_rad), np.sin(box.yaw_rad)
    local = (points - box.centre_m) @ np.array([[c, -s], [s, c]])
    return np.linalg.norm(np.maximum(np.abs(local) - np.array(box.size_m[:2]) / 2, 0.0), axis=1)


def _outline(box: Box) -> NDArray[np.float64]:
    """Points all over the footprint, so that no box can hide inside another."""
    x, y = np.meshgrid(np.linspace(-0.5, 0.5, 9) * box.size_m[0], np.linspace(-0.5, 0.5, 9) * box.size_m[1])
    c, s = np.cos(box.yaw_rad), np.sin(box.yaw_rad)
    return np.column_stack([x.ravel(), y.ravel()]) @ np.array([[c, s], [-s, c]]) + box.centre_m
