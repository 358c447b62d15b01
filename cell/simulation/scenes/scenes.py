"""Scenes of strings on a table, over and under each other."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from cell.config.camera_config import SCENES
from cell.config.strict_model import unit_hint
from cell.simulation.scenes.clutter import Box, Cloth, Clump, Rod, fixture_edge, place_boxes, place_clump
from cell.simulation.scenes.layout import SceneError, SceneRequest, draft
from cell.simulation.scenes.low_obstacles import KINDS, draw_plate, place_low_objects
from cell.simulation.scenes.placement import lay_down
from cell.simulation.scenes.planar_crossings import is_closed
from cell.simulation.scenes.stacking_heights import HeightsError
from cell.simulation.scenes.strand_clearance import MIN_SIDE_CLEARANCE, SIDE_CLEARANCE

__all__ = ["SCENES", "SceneError", "StringScene", "make_scene"]


@dataclass(frozen=True, eq=False)
class StringScene:
    """Strings on the table z = 0 around the origin of the base frame."""

    name: str
    radius_m: float
    """Radius of the first string."""
    curves: tuple[NDArray[np.float64], ...]
    """Centre line of each string (N, 3), in steps of about 1 mm. The ends are square, without a cap."""
    boxes: tuple[Box, ...] = field(default=())
    """Boxes beside or under the strings."""
    clumps: tuple[Clump, ...] = field(default=())
    """Clumps beside the strings."""
    rods: tuple[Rod, ...] = field(default=())
    """Pens and posts beside the strings."""
    cloths: tuple[Cloth, ...] = field(default=())
    """Cloths beside the strings."""
    radii_m: tuple[float, ...] = field(default=())
    """Radius of each string. By default all have `radius_m`."""

    def __post_init__(self) -> None:
        if not self.radii_m:
            object.__setattr__(self, "radii_m", (self.radius_m,) * len(self.curves))
        if len(self.radii_m) != len(self.curves):
            raise SceneError(f"{self.name}: {len(self.curves)} strings have {len(self.radii_m)} radii")

    @property
    def closed(self) -> tuple[bool, ...]:
        """Whether each string is a ring, whose last point is its first."""
        return tuple(is_closed(curve) for curve in self.curves)


_DRAWS = 12
"""Number of drafts that are tried for a scene."""

_ONE_OR_NO_CROSSING = ("ring", "end-on-strand", *KINDS)
_CROSSINGS = ("coil", "several", "random", "tangle", "settled", "mixed-radii", *_ONE_OR_NO_CROSSING)
_STRINGS = {
    "several": (1, 6),
    "random": (1, 6),
    "tangle": (1, 6),
    "settled": (1, 6),
    "mixed-radii": (2, 6),
    "side-by-side": (1, 2),
}


def make_scene(
    name: str,
    seed: int,
    radius_m: float = 0.0042,
    length_m: float = 0.4,
    softness: float = 1.0,
    crossings: int | None = None,
    clutter: int = 0,
    strings: int | None = None,
    clearance: float = SIDE_CLEARANCE,
) -> StringScene:
    """Return a scene. The same arguments give the same arrays.

    - straight, arc: no crossing
    - loop, figure-eight: one crossing
    - overhand-knot: three crossings, alternating, of equal sign
    - coil: `crossings` turns (2 by default), each over the one before
    - several: `strings` (2 or 3) strings with `crossings` crossings (1 to 4 by default)
    - random: `strings` (1 by default) with `crossings` crossings (0 to 2 by default)
    - tangle: cables of different lengths with varying curvature, partly side by side, crossing at 25 degrees or more
    - settled: as random, then released under weight, stiffness and contact
    - mixed-radii: thick and thin strings that cross
    - ring: a closed string, with or without a crossing
    - stacked: three strands above one point
    - side-by-side: a string folded back, or two strings, in contact over 30 to 80 mm
    - end-on-strand: an end that lies on another strand (`crossings` 1) or butts against its side (0)
    - long: a flat spiral
    - empty: no string, but the edge of a fixture, a clump like a hand, and boxes
    - bar, post, slot, wall: a gently curved string with no or one crossing, and low or thin objects beside it
    - plate: the same string, partly or wholly on a plate

    Args:
        name: One of `SCENES`.
        seed: Seed of the scene.
        radius_m: Radius of every string, or of the thickest one in mixed-radii.
        length_m: Length of every string along its centre line, or the mean length in tangle.
        softness: Height between the centre lines at a crossing, relative to 2 r. Less than 1 presses them together.
        crossings: Number of crossings, for the scenes in which it can be chosen.
        clutter: Number of boxes beside the strings.
        strings: Number of strings, for the scenes in which it can be chosen.
        clearance: Smallest distance of strands that do not cross, in radii, for the random scenes. At 2.4 strands
            nearly touch.

    Raises:
        SceneError: The name is unknown, a value is out of range, or no such scene can be made.
    """
    _check(name, seed, radius_m, length_m, softness, crossings, clutter, strings, clearance)
    rng = np.random.default_rng([SCENES.index(name), seed])
    request = SceneRequest(name, radius_m, length_m, softness, crossings, strings, clearance)
    curves, radii_m, objects = _lay(rng, request)
    standing = (fixture_edge(rng),) if name == "empty" else objects
    boxes = place_boxes(rng, curves, radius_m, clutter, standing)
    clump = place_clump(rng, boxes) if name == "empty" and boxes is not None else None
    if boxes is None or (name == "empty" and clump is None):
        raise SceneError(f"{name}: there is no room for {clutter} boxes beside the strings; use fewer")
    clumps = () if clump is None else (clump,)
    return StringScene(f"{name}-{seed}", radii_m[0] if radii_m else radius_m, curves, boxes, clumps, radii_m=radii_m)


def _lay(
    rng: np.random.Generator, request: SceneRequest
) -> tuple[tuple[NDArray[np.float64], ...], tuple[float, ...], tuple[Box, ...]]:
    """Return the centre lines (N, 3), the radii, and the objects that belong to the scene.

    The draft is repeated if strands touch, if they cannot lie over each other, or if no object fits beside them.
    """
    if request.name == "empty":
        return (), (), ()
    reason = ""
    for _ in range(_DRAWS):
        drawn = draft(rng, request)
        objects: tuple[Box, ...] | None = (draw_plate(rng, drawn.plan),) if request.name == "plate" else ()
        try:
            curves = lay_down(rng, drawn, request, objects)
        except HeightsError as error:
            reason = str(error)
            continue
        if request.name in KINDS and request.name != "plate":
            objects = place_low_objects(rng, request.name, curves, request.radius_m)
        if objects is None:
            reason = "no object fits beside the string"
            continue
        return tuple(curves), tuple(drawn.radii_m), objects
    raise SceneError(
        f"{request.name}: {reason} when a string of {request.length_m:g} m has a radius of {request.radius_m:g} m; "
        "use a longer or a thinner one"
    )


def _check(
    name: str,
    seed: int,
    radius_m: float,
    length_m: float,
    softness: float,
    crossings: int | None,
    clutter: int,
    strings: int | None,
    clearance: float,
) -> None:
    if name not in SCENES:
        raise SceneError(f"there is no scene {name!r}; known are {', '.join(SCENES)}")
    most_strings = _STRINGS.get(name, (1, 6))
    for what, value, low, high in (
        ("seed", seed, 0, 2**63),
        ("radius_m", radius_m, 0.0005, 0.02),
        ("length_m", length_m, 0.05, 12.0),
        ("softness", softness, 0.6, 1.0),
        ("clutter", clutter, 0, 20),
        ("crossings", 0 if crossings is None else crossings, 0, 1 if name in _ONE_OR_NO_CROSSING else 40),
        ("strings", most_strings[0] if strings is None else strings, *most_strings),
        ("clearance", clearance, MIN_SIDE_CLEARANCE, 20.0),
    ):
        if not low <= value <= high:
            hint = unit_hint(what, value, low, high)
            raise SceneError(f"{name}: {what} is {value!r}; it must be from {low:g} to {high:g}{hint}")
    if length_m < 12 * radius_m:
        raise SceneError(f"{name}: a string of {length_m:g} m is too short for a radius of {radius_m:g} m")
    if crossings is not None and name not in _CROSSINGS:
        raise SceneError(f"{name} has a fixed number of crossings; {', '.join(_CROSSINGS)} take one")
    if strings is not None and name not in _STRINGS:
        raise SceneError(f"{name} has a fixed number of strings; {', '.join(_STRINGS)} take one")
    if name == "coil" and crossings == 0:
        raise SceneError("coil: at least one crossing is needed")
