"""Cases of strings that lie close together."""

import numpy as np
import pytest
from scipy.spatial import KDTree

from cell.simulation.cases import make_case
from cell.simulation.scenes.ground_truth import true_crossings
from recognition.geometry.polyline import resample

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("seed", [0, 1])
def test_strands_lie_side_by_side_in_contact(seed: int) -> None:
    scene = make_case("side", seed).scene
    assert len(scene.curves) == seed % 2 + 1
    assert true_crossings(scene) == []
    lines = [resample(curve, 0.001) for curve in scene.curves]
    points = np.vstack(lines)
    strand = np.repeat(np.arange(len(lines)), [len(line) for line in lines])
    place = np.concatenate([np.arange(len(line)) for line in lines])
    near = KDTree(points).query_pairs(2.1 * scene.radius_m, output_type="ndarray")
    a, b = near.T
    # Apart by at least 8 radii along the string, so that a bend does not count.
    is_contact = (strand[a] != strand[b]) | (abs(place[a] - place[b]) > 8000 * scene.radius_m)
    # One point per millimetre; 30 mm of contact or more, less 10 % for the step of the lines.
    assert len(np.unique(a[is_contact])) >= 27


@pytest.mark.parametrize("seed", [0, 3])  # these are drawn quickly
def test_dense_tangles_have_ten_to_twenty_crossings(seed: int) -> None:
    scene = make_case("dense", seed).scene
    assert 2 <= len(scene.curves) <= 4
    assert 10 <= len(true_crossings(scene)) <= 20
