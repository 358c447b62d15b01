import copy
from typing import Any

import numpy as np
import pytest

from calibration.transforms import from_rotation_vector, transform_points
from cell.simulation.scenes import make_scene
from cell.simulation.scoring import ScoringError, score
from cell.simulation.truth import scene_truth


@pytest.fixture(scope="module", params=["overhand-knot", "several"])
def truth(request: pytest.FixtureRequest) -> dict[str, Any]:
    return scene_truth(make_scene(request.param, 1), [], np.eye(4))


def perfect(truth: dict[str, Any]) -> dict[str, Any]:
    """The truth as a model; the strings last first, and every other one backwards."""
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


def test_the_truth_itself_is_perfect(truth: dict[str, Any]) -> None:
    result = score(perfect(truth), truth)
    assert result.topology
    assert result.confident_mistakes == 0
    assert (result.chains, result.crossings) == (len(truth["curves"]), len(truth["crossings"]))
    assert result.cover == 1.0
    # The two are sampled from opposite ends: samples 0.5 mm apart need not meet.
    for error in (result.mean_m, result.p95_m, result.shape_m):
        assert error is not None
        assert error < 0.26e-3
    assert result.end_m == 0.0


def test_a_lifted_model_is_wrong_by_that_height_but_not_in_shape(truth: dict[str, Any]) -> None:
    T = from_rotation_vector((0.0, 0.0, 0.002), (0.0, 0.0, 0.0))
    result = score(moved(perfect(truth), T), truth)
    assert result.topology
    # Lifted strands are nearer to the true ramps beside them than 2 mm, and samples are 0.5 mm apart.
    assert result.mean_m == pytest.approx(0.002, rel=0.05)
    assert result.end_m == pytest.approx(0.002)
    assert result.shape_m is not None
    assert result.shape_m < 0.26e-3


def test_exchanged_over_and_under_is_a_confident_mistake(truth: dict[str, Any]) -> None:
    model = perfect(truth)
    crossing = model["crossings"][0]
    crossing["over"], crossing["under"] = crossing["under"], crossing["over"]
    result = score(model, truth)
    assert not result.topology
    assert result.confident_mistakes == 1
    crossing["confidence"] = 0.6
    assert score(model, truth).confident_mistakes == 0


def test_missing_and_invented_crossings_are_wrong(truth: dict[str, Any]) -> None:
    missing, invented = perfect(truth), perfect(truth)
    missing["crossings"].pop()
    invented["crossings"].append(invented["crossings"][0])
    assert not score(missing, truth).topology
    assert not score(invented, truth).topology


def test_a_crossing_far_from_its_place_is_wrong(truth: dict[str, Any]) -> None:
    model = perfect(truth)
    model["crossings"][0]["point"] = [1.0, 0.0, 0.0]
    assert not score(model, truth).topology


def test_a_shortened_chain_misses_an_end(truth: dict[str, Any]) -> None:
    model = perfect(truth)
    model["chains"][0]["points"] = model["chains"][0]["points"][:-10]
    result = score(model, truth)
    # Nearly: the string bends.
    assert result.end_m == pytest.approx(0.02, rel=0.05)
    # 20 mm of string less the radius, within which it still counts as covered.
    lost = (0.02 - truth["radius"]) / (0.4 * len(truth["curves"]))
    assert result.cover == pytest.approx(1 - lost, abs=0.003)


def test_a_broken_string_is_wrong(truth: dict[str, Any]) -> None:
    model = perfect(truth)
    points = model["chains"][0]["points"]
    model["chains"][0]["points"] = points[:150]
    model["chains"].append({"id": 77, "points": points[151:]})
    result = score(model, truth)
    assert not result.topology
    assert result.chains == len(truth["curves"]) + 1


def test_no_chain_is_no_distance(truth: dict[str, Any]) -> None:
    result = score({"chains": [], "crossings": []}, truth)
    assert (result.mean_m, result.end_m, result.cover, result.topology) == (None, None, 0.0, False)


@pytest.mark.parametrize(
    ("model", "message"),
    [
        ({"error": {"detail": "no depth"}}, "no depth"),
        ({"chains": []}, "crossings"),
        ({"chains": [{"points": [[0, 0, 0], [1, 1, 1]]}], "crossings": []}, "id"),
    ],
)
def test_what_is_no_model_is_refused(truth: dict[str, Any], model: dict[str, Any], message: str) -> None:
    with pytest.raises(ScoringError, match=message):
        score(model, truth)


def test_what_is_no_truth_is_refused() -> None:
    with pytest.raises(ScoringError, match="radius"):
        score({"chains": [], "crossings": []}, {"name": "x"})
