import numpy as np
import pytest

from cell.simulation.scenes.clutter import distance_to_box
from cell.simulation.scenes.ground_truth import true_crossings
from cell.simulation.scenes.scenes import SCENES, SceneError, StringScene, make_scene
from cell.simulation.scenes.shapes import polyline_length
from cell.simulation.scenes.strand_clearance import deepest_overlap
from recognition.geometry.polyline import arc_length

pytestmark = pytest.mark.slow

FIXED_CROSSINGS = {"straight": 0, "arc": 0, "loop": 1, "figure-eight": 1, "overhand-knot": 3, "coil": 2}


def least_distances(scene: StringScene) -> tuple[float, float]:
    """Return the least distance of two strands near crossings and elsewhere, in units of 2 r.

    Points of one string count when they are farther apart along it than a quarter turn of the tightest bend.
    """
    points = np.vstack(scene.curves)
    string = np.repeat(np.arange(len(scene.curves)), [len(curve) for curve in scene.curves])
    s = np.concatenate([arc_length(curve) for curve in scene.curves])
    i, j = np.triu_indices(len(points), 1)
    other = (string[i] != string[j]) | (np.abs(s[i] - s[j]) > 8 * scene.radius_m)
    i, j = i[other], j[other]
    crossings = np.array([x["point"][:2] for x in true_crossings(scene)]).reshape(-1, 2)
    near = np.zeros(len(points), dtype=bool)
    for x in crossings:
        near |= np.linalg.norm(points[:, :2] - x, axis=1) < 6 * scene.radius_m
    distance = np.linalg.norm(points[i] - points[j], axis=1) / (2 * scene.radius_m)
    at_crossing = near[i] & near[j]
    return float(distance[at_crossing].min(initial=np.inf)), float(distance[~at_crossing].min(initial=np.inf))


def signs(scene: StringScene) -> list[int]:
    """Return the right-handed sign of each crossing: the z component of over direction x under direction."""
    result = []
    for crossing in true_crossings(scene):
        directions = []
        for string, s in (crossing["over"], crossing["under"]):
            curve = scene.curves[string]
            k = int(np.searchsorted(arc_length(curve), s))
            directions.append(curve[k] - curve[k - 1])
        over, under = directions
        result.append(int(np.sign(over[0] * under[1] - over[1] * under[0])))
    return result


@pytest.mark.parametrize("name", SCENES)
def test_the_same_seed_gives_the_same_arrays_and_another_seed_others(name: str) -> None:
    first, again, other = (make_scene(name, seed, clutter=2) for seed in (4, 4, 5))
    assert all(np.array_equal(a, b) for a, b in zip(first.curves, again.curves, strict=True))
    assert first.boxes == again.boxes
    assert first.clumps == again.clumps
    if first.curves:
        assert not np.array_equal(first.curves[0], other.curves[0])
    else:
        assert first.boxes != other.boxes


@pytest.mark.parametrize("name", FIXED_CROSSINGS)
@pytest.mark.parametrize("seed", range(4))
def test_named_scenes_have_their_crossings(name: str, seed: int) -> None:
    assert len(true_crossings(make_scene(name, seed))) == FIXED_CROSSINGS[name]


@pytest.mark.parametrize("crossings", [0, 1, 2])
def test_random_scenes_have_the_requested_number_of_crossings(crossings: int) -> None:
    for seed in range(3):
        assert len(true_crossings(make_scene("random", seed, crossings=crossings))) == crossings


def test_several_strings_cross() -> None:
    for seed in range(3):
        scene = make_scene("several", seed)
        assert len(scene.curves) in (2, 3)
        assert 1 <= len(true_crossings(scene)) <= 4
    tangle = make_scene("several", 0, radius_m=0.003, length_m=0.5, strings=3, crossings=5)
    assert (len(tangle.curves), len(true_crossings(tangle))) == (3, 5)


def test_each_turn_of_a_coil_crosses_over_the_previous_one() -> None:
    crossings = true_crossings(make_scene("coil", 2, length_m=0.9, crossings=4))
    assert len(crossings) == 4
    assert all(x["over"][1] > x["under"][1] for x in crossings)


def test_the_overhand_knot_is_a_trefoil() -> None:
    handedness = set()
    for seed in range(8):
        scene = make_scene("overhand-knot", seed)
        crossings = true_crossings(scene)
        passes = sorted((x[role][1], role) for x in crossings for role in ("over", "under"))
        roles = [role for _, role in passes]
        assert roles in (["over", "under"] * 3, ["under", "over"] * 3)
        assert len(set(signs(scene))) == 1
        handedness |= set(signs(scene))
    assert handedness == {-1, 1}


CROSSING_ONLY = [name for name in SCENES if name not in ("side-by-side", "end-on-strand", "empty")]
"""Scenes whose strands touch at crossings only."""

SOLID = [(name, 1, {}) for name in CROSSING_ONLY] + [
    ("random", 2, {"crossings": 2, "softness": 0.6}),
    ("overhand-knot", 2, {"softness": 0.8}),
    ("random", 3, {"crossings": 4, "length_m": 0.8, "radius_m": 0.003}),
]


@pytest.mark.parametrize(("name", "seed", "options"), SOLID)
def test_strings_lie_on_the_table_without_overlaps(name: str, seed: int, options: dict) -> None:
    scene = make_scene(name, seed, **options)
    softness = options.get("softness", 1.0)
    if name in ("mixed-radii", "ring"):
        assert deepest_overlap(scene.curves, scene.radii_m) < 0.02
        return
    at_crossing, elsewhere = least_distances(scene)
    assert min(curve[:, 2].min() for curve in scene.curves) >= scene.radius_m * (1 - 1e-9)
    # Contacts are enforced at points 1 mm apart. Between these points, 1 % of 2 r may be missing.
    assert at_crossing >= softness - 0.01
    assert elsewhere >= 1.0
    if true_crossings(scene):
        assert at_crossing <= softness + 0.05


@pytest.mark.parametrize("softness", [1.0, 0.6])
def test_over_strands_touch_under_strands(softness: float) -> None:
    scene = make_scene("figure-eight", 1, softness=softness)
    (crossing,) = true_crossings(scene)
    z = [
        float(np.interp(crossing[role][1], arc_length(scene.curves[0]), scene.curves[0][:, 2]))
        for role in ("over", "under")
    ]
    # The two are interpolated between points 1 mm apart.
    assert z[0] - z[1] == pytest.approx(softness * 2 * scene.radius_m, rel=0.01)


@pytest.mark.parametrize("name", SCENES)
def test_strings_have_the_requested_length_in_space(name: str) -> None:
    scene = make_scene(name, 0, length_m=0.45)
    lengths_m = np.array([polyline_length(curve) for curve in scene.curves])
    # Steps of 1 mm cut the corners of the tightest bends, of about 1 cm: (1/10)^2/24 of the length.
    if name == "tangle":
        assert lengths_m.sum() == pytest.approx(0.45 * len(lengths_m), abs=2e-4 * len(lengths_m))
    else:
        assert lengths_m == pytest.approx(np.full(len(lengths_m), 0.45), abs=2e-4)


def test_a_long_string_can_have_many_crossings() -> None:
    scene = make_scene("random", 3, length_m=4.0, crossings=8)
    assert len(true_crossings(scene)) == 8
    assert deepest_overlap(scene.curves, scene.radii_m) < 0.02


def test_boxes_do_not_touch_the_strings() -> None:
    scene = make_scene("random", 1, clutter=4)
    assert len(scene.boxes) == 4
    for box in scene.boxes:
        assert distance_to_box(scene.curves[0][:, :2], box).min() >= scene.radius_m + 0.005


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"name": "bowline"}, "known are straight, arc, loop"),
        ({"radius_m": 0.1}, "radius_m is 0.1; it must be from 0.0005 to 0.02"),
        ({"radius_m": float("nan")}, "radius_m is nan"),
        ({"length_m": -1.0}, "length_m is -1.0"),
        ({"softness": 0.2}, "softness is 0.2"),
        ({"seed": -1}, "seed is -1"),
        ({"clutter": -1}, "clutter is -1"),
        ({"name": "loop", "crossings": 2}, "loop has a fixed number of crossings"),
        ({"name": "arc", "strings": 2}, "arc has a fixed number of strings"),
        ({"name": "ring", "crossings": 2}, "crossings is 2; it must be from 0 to 1"),
        ({"name": "side-by-side", "strings": 3}, "strings is 3; it must be from 1 to 2"),
        ({"name": "coil", "crossings": 0}, "at least one crossing"),
        ({"name": "overhand-knot", "length_m": 0.15}, "use a longer or a thinner one"),
        ({"length_m": 0.1, "crossings": 5}, "use longer strings for more crossings"),
        ({"radius_m": 0.01, "length_m": 0.1}, "too short for a radius"),
        ({"name": "straight", "clutter": 20, "length_m": 0.05, "radius_m": 0.002}, "no room for 20 boxes"),
    ],
)
def test_impossible_scenes_are_rejected(arguments: dict, message: str) -> None:
    with pytest.raises(SceneError, match=message):
        make_scene(**{"name": "random", "seed": 0} | arguments)
