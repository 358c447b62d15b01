import copy
from typing import Any

import numpy as np
import pytest

from calibration.geometry.transforms import from_rotation_vector, transform_points
from cell.simulation.evaluation.metrics import ScoringError, score
from cell.simulation.scenes.ground_truth import scene_truth
from cell.simulation.scenes.scenes import make_scene


@pytest.fixture(scope="module", params=["overhand-knot", "several"])
def truth(request: pytest.FixtureRequest) -> dict[str, Any]:
    return scene_truth(make_scene(request.param, 1), [], np.eye(4))


def perfect(truth: dict[str, Any]) -> dict[str, Any]:
    """Return the truth as a model, with the strings in reverse order and every second string backwards."""
    count = len(truth["curves"])
    length = [float(np.linalg.norm(np.diff(curve, axis=0), axis=1).sum()) for curve in truth["curves"]]

    def strand(string: int, s: float) -> dict[str, Any]:
        return {"chain": count - 1 - string, "s_m": length[string] - s if string % 2 else s}

    return {
        "chains": [
            {"id": count - 1 - k, "points": curve[::-1] if k % 2 else curve}
            for k, curve in reversed(list(enumerate(truth["curves"])))
        ],
        "crossings": [
            {"point": x["point"], "over": strand(*x["over"]), "under": strand(*x["under"]), "confidence": 0.95}
            for x in truth["crossings"]
        ],
    }


def moved(model: dict[str, Any], T: np.ndarray) -> dict[str, Any]:
    result = copy.deepcopy(model)
    for chain in result["chains"]:
        chain["points"] = transform_points(T, np.array(chain["points"])).tolist()
    return result


def test_the_truth_as_a_model_has_a_perfect_score(truth: dict[str, Any]) -> None:
    result = score(perfect(truth), truth)
    assert result.topology
    assert result.confident_mistakes == 0
    assert (result.chains, result.crossings) == (len(truth["curves"]), len(truth["crossings"]))
    assert result.cover == 1.0
    # The samples of the two lines are shifted. In bends of some centimetres, chords of 0.5 mm are off by 1 um.
    for error in (result.mean_m, result.p95_m, result.shape_m):
        assert error is not None
        assert error < 2e-6
    assert result.end_m == 0.0


def test_a_lifted_model_has_its_height_as_the_mean_error_and_no_shape_error(truth: dict[str, Any]) -> None:
    T = from_rotation_vector((0.0, 0.0, 0.002), (0.0, 0.0, 0.0))
    result = score(moved(perfect(truth), T), truth)
    assert result.topology
    # Some lifted points are closer than 2 mm to a rising part of the true strands.
    assert result.mean_m == pytest.approx(0.002, rel=0.05)
    assert result.end_m == pytest.approx(0.002)
    # Five iterations of the fit leave some hundredths of the height.
    assert result.shape_m is not None
    assert result.shape_m < 0.05e-3


def test_exchanged_over_and_under_is_a_confident_mistake(truth: dict[str, Any]) -> None:
    model = perfect(truth)
    crossing = model["crossings"][0]
    crossing["over"], crossing["under"] = crossing["under"], crossing["over"]
    result = score(model, truth)
    assert not result.topology
    assert result.confident_mistakes == 1
    crossing["confidence"] = 0.6
    assert score(model, truth).confident_mistakes == 0


def test_missing_and_surplus_crossings_are_wrong(truth: dict[str, Any]) -> None:
    missing, surplus = perfect(truth), perfect(truth)
    missing["crossings"].pop()
    surplus["crossings"].append(surplus["crossings"][0])
    assert not score(missing, truth).topology
    assert not score(surplus, truth).topology


def test_a_crossing_far_from_its_true_position_is_wrong(truth: dict[str, Any]) -> None:
    model = perfect(truth)
    model["crossings"][0]["point"] = [1.0, 0.0, 0.0]
    assert not score(model, truth).topology


def test_a_shortened_chain_misses_an_end(truth: dict[str, Any]) -> None:
    model = perfect(truth)
    model["chains"][0]["points"] = model["chains"][0]["points"][:-10]
    result = score(model, truth)
    # The string bends, so the distance is slightly less than the arc length.
    assert result.end_m == pytest.approx(0.02, rel=0.05)
    # A length of about the radius within the 20 mm still counts as covered.
    lost = (0.02 - truth["radius"]) / (0.4 * len(truth["curves"]))
    assert result.cover == pytest.approx(1 - lost, abs=0.003)


def test_a_string_in_two_chains_is_wrong(truth: dict[str, Any]) -> None:
    model = perfect(truth)
    points = model["chains"][0]["points"]
    model["chains"][0]["points"] = points[:150]
    model["chains"].append({"id": 77, "points": points[151:]})
    result = score(model, truth)
    assert not result.topology
    assert result.chains == len(truth["curves"]) + 1


def test_without_chains_the_distances_are_none(truth: dict[str, Any]) -> None:
    result = score({"chains": [], "crossings": []}, truth)
    assert (result.mean_m, result.end_m, result.cover, result.topology) == (None, None, 0.0, False)


def ring_truth() -> dict[str, Any]:
    """Return the truth of a ring of radius 60 mm that crosses a straight string, once over and once under."""
    angle = np.linspace(0.0, 2 * np.pi, 301)
    ring = 0.06 * np.column_stack([np.cos(angle), np.sin(angle), np.full_like(angle, 0.1)])
    bar = np.column_stack([np.linspace(-0.1, 0.1, 101), np.zeros(101), np.full(101, 0.1)])
    circumference_m = 2 * np.pi * 0.06
    return {
        "name": "ring",
        "radius": 0.004,
        "radii": [0.004, 0.002],
        "closed": [True, False],
        "curves": [ring.tolist(), bar.tolist()],
        "crossings": [
            {"point": [0.06, 0.0, 0.1], "over": [0, 0.0], "under": [1, 0.16]},
            {"point": [-0.06, 0.0, 0.1], "over": [1, 0.04], "under": [0, circumference_m / 2]},
        ],
    }


def ring_model(start: int, backwards: bool) -> dict[str, Any]:
    """Return `ring_truth` as a model. The ring begins at point `start` and does not repeat its first point."""
    truth = ring_truth()
    ring = truth["curves"][0][:-1]
    ring = ring[start:] + ring[:start]
    circumference_m = 2 * np.pi * 0.06

    def along(s: float) -> float:
        s = (s - start / 300 * circumference_m) % circumference_m
        return (circumference_m - s) % circumference_m if backwards else s

    # The reversed ring begins at the same point, as in `along`.
    ring = ring[:1] + ring[:0:-1] if backwards else ring
    return {
        "chains": [
            {"id": 0, "closed": True, "points": ring},
            {"id": 1, "closed": False, "points": truth["curves"][1]},
        ],
        "crossings": [
            {
                "point": [0.06, 0.0, 0.1],
                "over": {"chain": 0, "s_m": along(0.0)},
                "under": {"chain": 1, "s_m": 0.16},
            },
            {
                "point": [-0.06, 0.0, 0.1],
                "over": {"chain": 1, "s_m": 0.04},
                "under": {"chain": 0, "s_m": along(circumference_m / 2)},
            },
        ],
    }


@pytest.mark.parametrize("backwards", [False, True])
@pytest.mark.parametrize("start", [0, 40, 150, 260])
def test_a_ring_may_begin_at_any_point_and_run_in_either_direction(start: int, backwards: bool) -> None:
    result = score(ring_model(start, backwards), ring_truth())
    assert result.topology
    assert result.confident_mistakes == 0
    assert result.true_ends == 2
    assert result.end_m == 0.0
    assert result.cover == 1.0


def test_an_open_chain_for_a_ring_is_wrong() -> None:
    model = ring_model(40, False)
    model["chains"][0]["closed"] = False
    assert not score(model, ring_truth()).topology


def test_a_ring_with_over_and_under_exchanged_is_wrong() -> None:
    model = ring_model(40, True)
    crossing = model["crossings"][1]
    crossing["over"], crossing["under"] = crossing["under"], crossing["over"]
    result = score(model, ring_truth())
    assert not result.topology
    assert result.confident_mistakes == 1


def test_a_ring_has_no_ends() -> None:
    truth, model = ring_truth(), ring_model(40, False)
    for document, key in ((truth, "curves"), (truth, "closed"), (truth, "radii"), (model, "chains")):
        document[key] = document[key][:1]
    truth["crossings"] = model["crossings"] = []
    result = score(model, truth)
    assert result.topology
    assert (result.true_ends, result.end_m, result.cover) == (0, None, 1.0)


def test_cover_uses_the_radius_of_each_string() -> None:
    # A chain 3 mm above its string covers a string of radius 4 mm, but not a string of radius 2 mm.
    T = from_rotation_vector((0.0, 0.0, 0.003), (0.0, 0.0, 0.0))
    result = score(moved(ring_model(0, False), T), ring_truth())
    ring, bar = 2 * np.pi * 0.06, 0.2
    assert result.cover == pytest.approx(ring / (ring + bar), abs=0.002)
    assert result.mean_m == pytest.approx(0.003, rel=1e-3)


def test_in_an_empty_scene_a_model_without_chains_is_right() -> None:
    truth = {"name": "empty", "radius": 0.004, "curves": [], "crossings": []}
    result = score({"chains": [], "crossings": []}, truth)
    assert (result.topology, result.cover, result.mean_m) == (True, 1.0, None)
    surplus = {"chains": [{"id": 0, "points": [[0, 0, 0], [0, 0, 1]]}], "crossings": []}
    assert not score(surplus, truth).topology


@pytest.mark.parametrize(
    ("model", "message"),
    [
        ({"error": {"detail": "no depth"}}, "no depth"),
        ({"chains": []}, "crossings"),
        ({"chains": [{"points": [[0, 0, 0], [1, 1, 1]]}], "crossings": []}, "id"),
    ],
)
def test_an_invalid_model_is_rejected(truth: dict[str, Any], model: dict[str, Any], message: str) -> None:
    with pytest.raises(ScoringError, match=message):
        score(model, truth)


def test_an_invalid_truth_is_rejected() -> None:
    with pytest.raises(ScoringError, match="radius"):
        score({"chains": [], "crossings": []}, {"name": "x"})
