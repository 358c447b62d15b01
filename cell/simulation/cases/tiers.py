"""Draw the case of a tier and a seed."""

from collections.abc import Callable, Mapping

import numpy as np

from cell.config.camera_names import DEFAULT_CAMERA, CameraName
from cell.simulation.cases.case import Case, TierError
from cell.simulation.cases.clutter_tier import draw_clutter
from cell.simulation.cases.crowded_tiers import draw_crowded
from cell.simulation.cases.end_tiers import draw_branches, draw_ends
from cell.simulation.cases.few_tier import draw_few
from cell.simulation.cases.first_tiers import draw_first
from cell.simulation.cases.heap_tier import draw_heap
from cell.simulation.cases.lifted_tier import draw_lifted
from cell.simulation.cases.mixed_tier import draw_mixed
from cell.simulation.cases.noise_tiers import draw_noisy
from cell.simulation.cases.thin_tier import draw_thin
from cell.simulation.cases.tier_camera import with_camera
from cell.simulation.cases.tight_tier import draw_knots
from cell.simulation.scenes.scenes import SceneError

Draw = Callable[[str, int, np.random.Generator], Case]
"""Function that draws the case of a tier's name, a seed and a generator. It raises SceneError if no scene is laid."""

_DRAWS: Mapping[str, tuple[int, Draw]] = {
    "paper": (0, draw_first),
    "long": (1, draw_first),
    "many": (2, draw_first),
    "physical": (3, draw_first),
    "soft": (4, draw_first),
    "photo": (5, draw_first),
    "hard": (6, draw_first),
    "measured": (7, draw_first),
    "fixtures": (8, draw_first),
    "tight": (9, draw_knots),
    "ends": (10, draw_ends),
    "branches": (11, draw_branches),
    "mixed": (12, draw_mixed),
    "lifted": (13, draw_lifted),
    "clutter": (14, draw_clutter),
    "speckle": (15, draw_noisy),
    "side": (16, draw_crowded),
    "dense": (17, draw_crowded),
    "heap": (18, draw_heap),
    "few": (19, draw_few),
    "noise": (20, draw_noisy),
    "thin": (21, draw_thin),
}
"""Number and function of each tier. The number is part of the seed of its scenes, so it never changes."""

TIERS = tuple(_DRAWS)
"""Names of all tiers."""

_MAX_DRAWS = 20
"""Maximum number of scenes that are drawn for a case until one can be laid."""


def make_case(tier: str, seed: int, camera: CameraName = DEFAULT_CAMERA) -> Case:
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
    - `tight`: in turn an overhand knot, a figure-eight knot, and a square knot of two strings, pulled to a core of 6 to
      12 radii, r = 3, 4 or 5 mm, with tails of 80 to 150 mm.
    - `ends`: one or two strings, r = 3, 4.2 or 5 mm, with an end near another end or strand. In turn: end to end with a
      gap of 1 to 4 r, 1 to 3 r beyond a strand over it, beyond a strand under it, below a strand, beside another strand
      and beside the own side (0 to 2 r).
    - `branches`: a string of 0.4 m and one or two that end in its centre line at 40 to 90 degrees, r = 3 to 5 mm, like
      a moulded cable harness.
    - `mixed`: two or three strings of 0.3 to 0.5 m with up to four crossings. The given radius is that of the thinnest,
      3 to 4 mm. The others have 1.25, 1.5 or 2 times this radius.
    - `lifted`: scenes of `paper` and `long` in turn, on a table 2 to 10 mm lower or higher than stated, tilted by 0.3
      to 2 degrees, or both.
    - `clutter`: one string of 0.4 to 0.5 m, r = 3, 4.2 or 5 mm, up to two crossings, with round objects beside it: in
      turn one or two pens, a cloth with folds, and posts of clips.
    - `speckle`: scenes of `paper` and `long` in turn. The strings lose 30 to 60 % of their pixels, independently or in
      small blobs.
    - `side`: a folded string, and two strings, in turn, in contact over 30 to 80 mm, r = 3, 4.2 or 5 mm.
    - `dense`: tangles of two to four strings with 10 to 20 crossings, r = 3 mm, at 800x500.
    - `heap`: one to five strings in turn, together 1.5 to 3 m long, r = 2.5 to 4 mm, dropped in loose coils by the
      physics of MuJoCo, with 12 to 40 crossings, at 800x500.
    - `few`: scenes of `paper`, `long` and `many` in turn, with one to four views in turn. A single view has
      a random direction, from 45 degrees to nearly straight down.
    - `noise`: scenes of `paper` and `long` in turn, with 1 to 4 times the errors of real cameras. Recognition must
      refuse the noisiest ones.
    - `thin`: one string of 0.25 m, r = 1 and 1.5 mm in turn, up to two crossings, at 1280x800 from 0.33 to 0.35 m.

    Args:
        tier: One of `TIERS`.
        seed: Seed of the case, 0 or more.
        camera: Camera that sees the scene. The tiers `measured`, `speckle` and `noise` keep their cameras.

    Returns:
        The case.

    Raises:
        PhysicsError: The tier is `heap`, and MuJoCo is not installed.
        TierError: The tier is unknown, the seed is negative, or no scene can be laid for the seed.
    """
    if tier not in TIERS:
        raise TierError(f"there is no tier {tier!r}; known are {', '.join(TIERS)}")
    if seed < 0:
        raise TierError(f"{tier}: seed is {seed}; it must be 0 or more")
    number, draw_case = _DRAWS[tier]
    reason: SceneError | None = None
    for draw in range(_MAX_DRAWS):
        rng = np.random.default_rng([number, seed, draw])
        try:
            return with_camera(draw_case(tier, seed, rng), camera)
        except SceneError as error:
            reason = error
    raise TierError(
        f"{tier}: no scene could be made for seed {seed}; choose another seed. The last reason is: {reason}"
    )
