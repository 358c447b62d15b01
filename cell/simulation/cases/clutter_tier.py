"""Tier of strings beside objects that are as round as strings: pens, folds of cloth, and posts."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from cell.simulation.cases.case import Case
from cell.simulation.pose_errors import PoseErrors
from cell.simulation.rendering.depth_camera import camera_model
from cell.simulation.scenes.clutter import Box, Cloth, Rod
from cell.simulation.scenes.scenes import SceneError, StringScene, make_scene

FREE_M = 0.005
"""Smallest free distance of an object from the strings and from other objects, seen from above."""
PEN_LENGTH_M = (0.10, 0.15)
"""Smallest and largest length of a pen."""
PEN_RADII = (1.25, 1.8)
"""Smallest and largest radius of a pen, in radii of the string. A pen as thick as the string looks like a straight
string."""
POST_RADIUS_M, POST_HEIGHT_M = (0.002, 0.004), (0.015, 0.06)
"""Smallest and largest radius, and height, of the post of a clip."""

_TRIES = 400
"""Number of positions that are tried for one object."""

Outline = NDArray[np.float64]
"""Points (N, 2) of an object, seen from above, a few millimetres apart."""


def draw_clutter(tier: str, seed: int, rng: np.random.Generator) -> Case:
    """Draw a case with pens, a cloth or posts, in turn.

    Args:
        tier: Name of the tier.
        seed: Seed of the case.
        rng: Generator of the scene.

    Raises:
        SceneError: The scene cannot be laid.
    """
    radius_m = float(rng.choice([0.003, 0.0042, 0.005]))
    length_m = float(rng.uniform(0.4, 0.5))
    scene = make_scene("random", int(rng.integers(2**31)), radius_m, length_m, crossings=int(rng.integers(3)))
    place = (_with_pens, _with_cloth, _with_posts)[seed % 3]
    return Case(tier, seed, place(rng, scene), camera_model("ideal"), PoseErrors())


def _with_pens(rng: np.random.Generator, scene: StringScene) -> StringScene:
    """Return the scene with one or two pens on the table."""
    taken, pens = _outlines(scene), []
    for _ in range(int(rng.integers(1, 3))):
        radius_m = scene.radius_m * float(rng.uniform(*PEN_RADII))
        length_m, yaw = float(rng.uniform(*PEN_LENGTH_M)), float(rng.uniform(0, np.pi))
        along = np.array([np.cos(yaw), np.sin(yaw)])
        outline = np.linspace(-length_m / 2, length_m / 2, 60)[:, None] * along
        centre = _free_place(rng, scene, outline, radius_m, taken)
        start, end = centre + outline[0], centre + outline[-1]
        pens.append(Rod((*start.tolist(), radius_m), (*end.tolist(), radius_m), radius_m))
        taken.append((centre + outline, radius_m))
    return replace(scene, name=scene.name.replace("random", "pen"), rods=tuple(pens))


def _with_cloth(rng: np.random.Generator, scene: StringScene) -> StringScene:
    """Return the scene with a cloth that has two to four folds."""
    half_m = float(rng.uniform(0.04, 0.06))
    grid = np.linspace(-half_m, half_m, 40)
    outline = np.stack(np.meshgrid(grid, grid), axis=-1).reshape(-1, 2)
    centre = _free_place(rng, scene, outline, 0.0, _outlines(scene))
    folds = []
    for k in range(int(rng.integers(2, 5))):
        t = np.linspace(-0.5, 0.5, 120) * rng.uniform(0.9, 1.4) * half_m
        bend = rng.uniform(-6.0, 6.0)
        line = np.column_stack([t, bend * t**2 + (k - 1.5) * 0.45 * half_m])
        yaw = rng.uniform(-0.15, 0.15)
        folds.append(line @ np.array([[np.cos(yaw), np.sin(yaw)], [-np.sin(yaw), np.cos(yaw)]]))
    turn = rng.uniform(0, np.pi)
    R = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    cloth = Cloth(
        (float(centre[0]), float(centre[1])),
        half_m,
        float(rng.uniform(0.001, 0.002)),
        tuple(centre + fold @ R.T for fold in folds),
        scene.radius_m * float(rng.uniform(1.3, 2.2)),
        scene.radius_m * float(rng.uniform(0.6, 0.9)),
    )
    return replace(scene, name=scene.name.replace("random", "cloth"), cloths=(cloth,))


def _with_posts(rng: np.random.Generator, scene: StringScene) -> StringScene:
    """Return the scene with one to three clips: a flat foot with a round post."""
    taken, posts, feet = _outlines(scene), [], []
    for _ in range(int(rng.integers(1, 4))):
        half_m, foot_m = float(rng.uniform(0.006, 0.012)), float(rng.uniform(0.001, 0.003))
        grid = np.linspace(-half_m, half_m, 9)
        outline = np.stack(np.meshgrid(grid, grid), axis=-1).reshape(-1, 2)
        x, y = _free_place(rng, scene, outline, 0.0, taken).tolist()
        top_m = float(rng.uniform(*POST_HEIGHT_M))
        posts.append(Rod((x, y, 0.0), (x, y, top_m), float(rng.uniform(*POST_RADIUS_M))))
        feet.append(Box((x, y), (2 * half_m, 2 * half_m, foot_m), 0.0))
        taken.append((outline + (x, y), 0.0))
    return replace(scene, name=scene.name.replace("random", "clip"), rods=tuple(posts), boxes=tuple(feet))


def _outlines(scene: StringScene) -> list[tuple[Outline, float]]:
    """Return the centre lines and radii of the strings, seen from above."""
    return [(curve[:, :2], radius_m) for curve, radius_m in zip(scene.curves, scene.radii_m, strict=True)]


def _free_place(
    rng: np.random.Generator,
    scene: StringScene,
    outline: Outline,
    radius_m: float,
    taken: Sequence[tuple[Outline, float]],
) -> NDArray[np.float64]:
    """Return a position (2,) at which an outline around the origin keeps `FREE_M` from everything.

    Raises:
        SceneError: There is no room.
    """
    from scipy.spatial import KDTree

    reach = max(float(np.linalg.norm(curve[:, :2], axis=1).max()) for curve in scene.curves) + 0.03
    for _ in range(_TRIES):
        bearing, distance = rng.uniform(0, 2 * np.pi), reach * np.sqrt(rng.random())
        centre = distance * np.array([np.cos(bearing), np.sin(bearing)])
        placed = centre + outline
        if all(KDTree(points).query(placed)[0].min() > radius_m + other_m + FREE_M for points, other_m in taken):
            return centre
    raise SceneError(f"{scene.name}: there is no room for an object beside the strings")
