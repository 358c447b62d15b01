import numpy as np
import pytest

from cell.simulation.scenes.ground_truth import true_crossings
from cell.simulation.scenes.rod_relaxation import settle
from cell.simulation.scenes.scenes import make_scene
from cell.simulation.scenes.strand_clearance import deepest_overlap

pytestmark = pytest.mark.slow

R = 0.004


def line(start: tuple[float, float, float], end: tuple[float, float, float]) -> np.ndarray:
    return np.linspace(start, end, round(float(np.linalg.norm(np.subtract(end, start))) / 0.001) + 1)


def test_a_single_string_does_not_move() -> None:
    t = np.linspace(0.0, 2.0, 200)
    arc = np.column_stack([0.08 * np.sin(t), 0.08 * (1 - np.cos(t)), np.full_like(t, R)])
    (rest,) = settle([arc], R, 1.0, 12.0, 1.0)
    radius_m = np.linalg.norm(rest[:, :2] - (0.0, 0.08), axis=1)
    # The table yields by 2e-4 radii under the weight of the string. The nodes are 3 mm apart.
    assert radius_m == pytest.approx(np.full(len(rest), 0.08), abs=2e-5)
    assert rest[:, 2] == pytest.approx(np.full(len(rest), R), abs=1e-5)


@pytest.mark.parametrize("hang_radii", [10.0, 14.0])
def test_a_string_over_another_bends_like_an_elastic_beam(hang_radii: float) -> None:
    under = line((0.0, -0.1, R), (0.0, 0.1, R))
    x = np.linspace(-0.12, 0.12, 241)
    over = np.column_stack([x, np.zeros_like(x), R + 2 * R * np.clip(1.5 - np.abs(x) / 0.03, 0, 1)])
    under_rest, over_rest = settle([under, over], R, 1.0, hang_radii, 1.0)
    # A beam lifted by h in its middle has z = h (4 v^3 - 3 v^4), with v from 0 at the table to 1 at the top.
    v = np.clip(1 - np.abs(over_rest[:, 0]) / (hang_radii * R), 0, 1)
    beam = R + 2 * R * (4 * v**3 - 3 * v**4)
    # Slopes of up to 0.4 stiffen the beam, and nodes 0.75 r apart flatten its top, which gives 3 % of h.
    assert np.abs(over_rest[:, 2] - beam).max() < 0.06 * R
    assert under_rest[:, 2] == pytest.approx(np.full(len(under_rest), R), rel=0.01)


def test_overlapping_strands_move_side_by_side() -> None:
    strands = [line((-0.05, y, R), (0.05, y, R)) for y in (-0.85 * R, 0.85 * R)]
    lower, upper = settle(strands, R, 1.0, 12.0, 1.0)
    # The remaining overlap after the slow creep of strands in the plane.
    assert upper[:, 1] - lower[:, 1] == pytest.approx(np.full(len(lower), 2 * R), rel=0.005)
    assert np.concatenate([lower[:, 2], upper[:, 2]]) == pytest.approx(R, rel=0.001)


@pytest.mark.parametrize("seed", range(3))
def test_settled_scenes_keep_their_crossings_without_overlaps(seed: int) -> None:
    scene = make_scene("settled", seed, crossings=2)
    assert len(true_crossings(scene)) == 2
    assert deepest_overlap(scene.curves, scene.radii_m) < 0.02
    assert min(curve[:, 2].min() for curve in scene.curves) >= scene.radius_m
