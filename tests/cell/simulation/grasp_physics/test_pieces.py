from dataclasses import replace

import numpy as np
import pytest

from cell.simulation.cases import make_case
from cell.simulation.grasp_physics.pieces import core_share, cut_pieces, segment_distance
from cell.simulation.grasp_physics.settings import PhysicsSettings
from cell.simulation.scenes.clutter import Box
from recognition.geometry.polyline import arc_length
from tests.cell.simulation.grasp_physics.scenes_and_grasps import straight_scene

SETTINGS = PhysicsSettings()


def test_a_string_is_cut_at_the_edge_of_the_region() -> None:
    (piece,) = cut_pieces(straight_scene(), np.array([0.02, 0.0, 0.0042]), SETTINGS)
    assert piece.points[0, 0] == pytest.approx(0.02 - SETTINGS.region_m, abs=0.001)
    assert piece.points[-1, 0] == pytest.approx(0.02 + SETTINGS.region_m, abs=0.001)
    assert np.allclose(piece.s_m - 0.15, (piece.points[1:, 0] + piece.points[:-1, 0]) / 2, atol=1e-9)
    assert piece.lengths_m == pytest.approx(np.full(len(piece.s_m), SETTINGS.segment_m), rel=0.1)
    assert not piece.carried.any()
    assert not piece.ring


def test_an_arch_that_is_cut_is_carried_and_a_string_on_a_plate_is_not() -> None:
    centre = np.zeros(3)
    flat = straight_scene()
    (curve,) = flat.curves
    # 30 mm wide, and highest where the string is cut.
    arch = curve + 0.01 * np.exp(-(((curve[:, :1] - SETTINGS.region_m) / 0.01) ** 2)) * (0.0, 0.0, 1.0)
    (piece,) = cut_pieces(replace(flat, curves=(arch,)), centre, SETTINGS)
    assert piece.carried[-3:].all()
    assert not piece.carried[: len(piece.carried) - 5].any()
    plate = Box((0.0, 0.0), (0.4, 0.06, 0.002), 0.0)
    on_plate = replace(flat, curves=(curve + (0.0, 0.0, 0.002),), boxes=(plate,))
    assert not cut_pieces(on_plate, centre, SETTINGS)[0].carried.any()


@pytest.mark.parametrize(("tier", "low", "high"), [("soft", 0.55, 0.65), ("many", 0.95, 1.0)])
def test_strands_that_are_pressed_together_have_a_thin_core(tier: str, low: float, high: float) -> None:
    scene = make_case(tier, 0).scene
    everything = PhysicsSettings(region_m=1.0)
    pieces = cut_pieces(scene, np.zeros(3), everything)
    lengths_m = [float(arc_length(curve)[-1]) for curve in scene.curves]
    assert low <= core_share(pieces, scene.closed, lengths_m) <= high


def test_segment_distance() -> None:
    rng = np.random.default_rng(1)
    a0, a1, b0, b1 = rng.standard_normal((4, 300, 3))
    share = np.linspace(0.0, 1.0, 201)
    for k, distance in enumerate(segment_distance(a0, a1, b0, b1)):
        a = a0[k] + share[:, None] * (a1 - a0)[k]
        b = b0[k] + share[:, None] * (b1 - b0)[k]
        sampled = np.linalg.norm(a[:, None] - b[None], axis=2).min()
        # A sample is off by at most half a step of each line.
        assert distance <= sampled + 1e-9
        assert distance > sampled - 0.01 * max(np.linalg.norm((a1 - a0)[k]), np.linalg.norm((b1 - b0)[k]))
