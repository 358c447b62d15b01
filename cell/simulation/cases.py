"""Draw simulated cases in tiers, from the scene of the paper to hard scenes. The benchmark recognises them."""

from dataclasses import dataclass, replace

import numpy as np

from cell.simulation.offline_scan import SimulatedScan
from cell.simulation.offline_scan import simulate as simulate_scene
from cell.simulation.pose_errors import PoseErrors
from cell.simulation.rendering.depth_camera import CameraModel, camera_model
from cell.simulation.scenes.low_obstacles import KINDS
from cell.simulation.scenes.scenes import SceneError, StringScene, make_scene
from cell.simulation.scenes.strand_clearance import MIN_SIDE_CLEARANCE, SIDE_CLEARANCE

TIERS = ("paper", "long", "many", "physical", "soft", "photo", "hard", "measured", "fixtures")
"""Names of all tiers. The index of a tier is part of the seed, so a new tier goes last."""

MEASURED_ERRORS = PoseErrors(robot_m=0.0001, robot_rad=0.0002, smooth_m=0.0006, smooth_rad=float(np.deg2rad(0.15)))
"""Pose errors of the tier `measured`. Real arms have a repeatability below 0.1 mm, and an error of 0.3 to 1.2 mm that
changes smoothly with the pose."""

_MAX_DRAWS = 20
"""Maximum number of scenes that are drawn for a case until one can be laid."""


class TierError(ValueError):
    """The tier does not exist, the seed is negative, or no scene can be laid for the seed."""

    slug = "tier"


@dataclass(frozen=True)
class Case:
    """A scene on the table, the camera, and the errors of the reported poses."""

    tier: str
    """Name of the tier."""
    seed: int
    """Seed of the case, and of its scan."""
    scene: StringScene
    """Strings on the table."""
    camera: CameraModel
    """Camera that sees the scene."""
    errors: PoseErrors
    """Errors of the reported poses."""


def make_case(tier: str, seed: int) -> Case:
    """Draw the case of a tier and a seed. The same arguments give the same case.

    - `paper`: one string of 0.4 m, r = 4.2 mm, 0 to 2 crossings.
    - `long`: one string of 0.7 m, 2 to 4 crossings.
    - `many`: two or three strings of 0.32 m.
    - `physical`: a string of 0.47 m, settled by weight and bending stiffness, 1 or 2 crossings.
    - `soft`: strands pressed together to 0.6 of the height between centre lines, 1 or 2 crossings.
    - `photo`: tangles as in photographs of real cables, r = 3 mm, up to three strings of 0.4 to 1.6 m and up to ten
      crossings, at 800x500.
    - `hard`: three kinds of scenes in turn, all with doubled pose errors. The first has a camera with a short baseline
      at 1280x800, the second r = 3 mm and boxes beside the string, the third a string of 1 m with five crossings.
    - `measured`: scenes of `paper` and `long` in turn, with the errors of real cameras and smooth errors of the
      reported flange pose.
    - `fixtures`: one string of 0.4 m, r = 3, 4.2 or 5 mm, no or one crossing, with low or thin objects: in turn bars, a
      plate, posts, slots and walls.

    Args:
        tier: One of `TIERS`.
        seed: Seed of the case, 0 or more.

    Returns:
        The case.

    Raises:
        TierError: The tier is unknown, the seed is negative, or no scene can be laid for the seed.
    """
    if tier not in TIERS:
        raise TierError(f"there is no tier {tier!r}; known are {', '.join(TIERS)}")
    if seed < 0:
        raise TierError(f"{tier}: seed is {seed}; it must be 0 or more")
    reason: SceneError | None = None
    for draw in range(_MAX_DRAWS):
        rng = np.random.default_rng([TIERS.index(tier), seed, draw])
        try:
            return _draw(tier, seed, rng)
        except SceneError as error:
            reason = error
    raise TierError(
        f"{tier}: no scene could be made for seed {seed}; choose another seed. The last reason is: {reason}"
    )


def simulate(case: Case) -> SimulatedScan:
    """Simulate the scan of a case: eight views and the truth. The same case gives the same scan."""
    return simulate_scene(case.scene, case.camera, case.seed, case.errors)


def _draw(tier: str, seed: int, rng: np.random.Generator) -> Case:
    """Draw one scene for the case. Raise SceneError if the scene cannot be laid."""
    if tier == "measured":
        case = _draw(("paper", "long")[seed % 2], seed, rng)
        return replace(case, tier=tier, camera=camera_model("oak-d-pro-measured"), errors=MEASURED_ERRORS)
    scene_seed = int(rng.integers(2**31))
    camera, errors = camera_model("oak-d-pro"), PoseErrors()
    match tier:
        case "paper":
            scene = make_scene("random", scene_seed, crossings=int(rng.integers(3)))
        case "long":
            scene = make_scene("random", scene_seed, length_m=0.7, crossings=int(rng.integers(2, 5)))
        case "many":
            scene = make_scene("several", scene_seed, length_m=0.32)
        case "physical":
            clearance = float(rng.choice([SIDE_CLEARANCE, MIN_SIDE_CLEARANCE]))
            crossings = int(rng.integers(1, 3))
            scene = make_scene("settled", scene_seed, length_m=0.47, crossings=crossings, clearance=clearance)
        case "soft":
            scene = make_scene("random", scene_seed, crossings=int(rng.integers(1, 3)), softness=0.6)
        case "photo":
            camera = camera_model("oak-d-pro", (800, 500))
            strings = int(rng.integers(1, 4))
            max_crossings = (4, 7, 10)[strings - 1]
            crossings = int(rng.integers(strings, max_crossings + 1))
            # The total length of all strings grows with the number of crossings.
            total_m = float(rng.uniform(0.5, 1.2) + 0.25 * (strings - 1) + 0.1 * crossings)
            scene = make_scene("tangle", scene_seed, 0.003, total_m / strings, crossings=crossings, strings=strings)
        case "fixtures":
            radius_m = float(rng.choice([0.003, 0.0042, 0.005]))
            scene = make_scene(KINDS[seed % len(KINDS)], scene_seed, radius_m)
        case _:
            errors = errors.scaled(2.0)
            if seed % 3 == 0:
                camera = camera_model("oak-d-sr")
                scene = make_scene("random", scene_seed, crossings=int(rng.integers(1, 3)))
            elif seed % 3 == 1:
                scene = make_scene("random", scene_seed, 0.003, 0.54, crossings=int(rng.integers(1, 4)), clutter=4)
            else:
                scene = make_scene("random", scene_seed, length_m=1.0, crossings=5)
    return Case(tier, seed, scene, camera, errors)
