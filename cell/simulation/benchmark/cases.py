"""Families of simulated cases, from the paper's scene to hard ones, for the evaluation of recognition."""

from dataclasses import dataclass, replace

import numpy as np

from cell.simulation.offline_scan import SimulatedScan
from cell.simulation.offline_scan import simulate as simulate_scene
from cell.simulation.pose_errors import PoseErrors
from cell.simulation.rendering.depth_camera import CameraModel, camera_model
from cell.simulation.scenes.scenes import SceneError, StringScene, make_scene
from cell.simulation.scenes.strand_clearance import MIN_SIDE_CLEARANCE, SIDE_CLEARANCE

TIERS = ("paper", "long", "many", "physical", "soft", "photo", "hard", "measured")
"""Names of the tiers."""

MEASURED_ERRORS = PoseErrors(robot_m=0.0001, robot_rad=0.0002, smooth_m=0.0006, smooth_rad=float(np.deg2rad(0.15)))
"""Pose errors of tier measured. A real arm repeats to less than 0.1 mm and errs smoothly by 0.3 to 1.2 mm."""

_DRAWS = 20
"""Number of scenes that are tried for a case."""


class TierError(ValueError):
    """The tier does not exist, or the seed is negative."""

    slug = "tier"


@dataclass(frozen=True)
class Case:
    """A scene, the camera, and the errors of the reported poses."""

    tier: str
    """Name of the tier."""
    seed: int
    """Number of the case."""
    scene: StringScene
    """Strings on the table."""
    camera: CameraModel
    """Camera that sees the scene."""
    errors: PoseErrors
    """Errors of the reported poses."""


def make_case(tier: str, seed: int) -> Case:
    """Return the case of a tier and a seed. The same arguments give the same arrays.

    - paper: one string of 0.4 m, r = 4.2 mm, 0 to 2 crossings
    - long: 0.7 m, 2 to 4 crossings
    - many: two or three strings
    - physical: strings settled by weight and bending stiffness
    - soft: strands pressed together to 0.6 of the height between centre lines
    - photo: tangles as in photographs of real cables, r = 3 mm, 0.4 to 1.6 m, up to three strings and ten crossings,
    800x500
    - hard, in turn: a camera of short baseline at 1280x800; r = 3 mm with boxes beside the string; 1 m with five
    crossings; all with doubled pose errors
    - measured: scenes of paper and long in turn, with the errors of real cameras and smooth errors of the flange pose

    Args:
        tier: One of `TIERS`.
        seed: Number of the case, from 0.

    Raises:
        TierError: The tier is unknown, or the seed is negative.
    """
    if tier not in TIERS:
        raise TierError(f"there is no tier {tier!r}; known are {', '.join(TIERS)}")
    if seed < 0:
        raise TierError(f"{tier}: seed is {seed}; 0 or more is taken")
    reason: SceneError | None = None
    for draw in range(_DRAWS):
        rng = np.random.default_rng([TIERS.index(tier), seed, draw])
        try:
            return _draw(tier, seed, rng)
        except SceneError as error:
            reason = error
    raise TierError(f"{tier}: no scene can be laid for seed {seed}: {reason}")


def simulate(case: Case) -> SimulatedScan:
    """Return the scan of a case, eight views with the truth. The same case gives the same content."""
    return simulate_scene(case.scene, case.camera, case.seed, case.errors)


def _draw(tier: str, seed: int, rng: np.random.Generator) -> Case:
    """Draw the case once. Raise SceneError if the scene cannot be made."""
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
            wished = int(rng.integers(1, 3))
            scene = make_scene("settled", scene_seed, length_m=0.47, crossings=wished, clearance=clearance)
        case "soft":
            scene = make_scene("random", scene_seed, crossings=int(rng.integers(1, 3)), softness=0.6)
        case "photo":
            camera = camera_model("oak-d-pro", (800, 500))
            strings = int(rng.integers(1, 4))
            most = (4, 7, 10)[strings - 1]
            crossings = int(rng.integers(strings, most + 1))
            # length of all cables together, which grows with the crossings
            total_m = float(rng.uniform(0.5, 1.2) + 0.25 * (strings - 1) + 0.1 * crossings)
            scene = make_scene("tangle", scene_seed, 0.003, total_m / strings, crossings=crossings, strings=strings)
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
