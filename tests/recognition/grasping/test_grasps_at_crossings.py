"""Grasps near crossings, and clearance of the grasps on simulated tangles from the true strings."""

import numpy as np
import pytest
from scipy.spatial import KDTree

from cell.simulation.scenes.scenes import make_scene
from recognition.assembly.crossings import find_crossings
from recognition.model.chains import Chain, Crossing, StrandPoint
from recognition.strand import Strand
from tests.recognition.straight_strings import (
    GRIPPER,
    HALF_FINGER,
    NOTHING,
    PARAMETERS,
    TABLE_Z,
    R,
    chain,
    finger_points,
    grasps_of,
    straight,
)


def crossed(height: float, confidence: float = 1.0) -> tuple[Chain, Chain, Crossing]:
    """A string along x on the table, one along y over it at that height of its centre line, crossing in the middle."""
    under, over = straight(), straight(z=height, degrees=90, number=1)
    middle = np.array([0, 0, TABLE_Z + (height + R) / 2])
    return (
        under,
        over,
        Crossing(0, middle, StrandPoint(1, 0.1), StrandPoint(0, 0.1), height - R, np.pi / 2, 1, confidence),
    )


def test_no_grasp_near_a_crossing_on_the_lower_strand() -> None:
    under, over, crossing = crossed(height=3 * R)
    grasps, _ = grasps_of(under, over, crossings=(crossing,))
    away = PARAMETERS.r_cn + HALF_FINGER
    below = np.abs([grasp.s_m - 0.1 for grasp in grasps if grasp.chain == 0])
    assert away <= below.min() < away + 0.005
    # The upper strand can be grasped there if the fingertips keep their clearance from the lower one.
    above = [grasp for grasp in grasps if grasp.chain == 1 and abs(grasp.s_m - 0.1) < 0.004]
    assert above
    for grasp in above:
        tips = 3 * R - grasp.reach_m - 2 * R
        assert grasp.clearance_m == pytest.approx(tips, abs=2e-4)  # balls leave notches of r / 30
        assert grasp.clearance_m >= GRIPPER.clearance_m
    best_away = max(grasp.score for grasp in grasps if grasp.chain == 1)
    assert max(grasp.score for grasp in above) < best_away / 2


def test_a_strand_pressed_into_the_lower_one_is_not_grasped_there() -> None:
    under, over, crossing = crossed(height=R + 0.6 * 2 * R)
    grasps, _ = grasps_of(under, over, crossings=(crossing,))
    assert min(abs(grasp.s_m - 0.1) for grasp in grasps if grasp.chain == 1) > R


def test_neither_strand_of_an_uncertain_crossing_is_grasped() -> None:
    under, over, crossing = crossed(height=3 * R, confidence=0.7)
    grasps, _ = grasps_of(under, over, crossings=(crossing,))
    away = PARAMETERS.r_cn + HALF_FINGER
    assert min(abs(grasp.s_m - 0.1) for grasp in grasps) >= away


def laid(curves: tuple[np.ndarray, ...]) -> tuple[tuple[Chain, ...], tuple[Crossing, ...]]:
    strands = [Strand(curve + np.array([0, 0, TABLE_Z]), np.zeros(len(curve), dtype=bool)) for curve in curves]
    crossings = find_crossings(strands, NOTHING, PARAMETERS).crossings
    return tuple(chain(strand.points, k) for k, strand in enumerate(strands)), tuple(crossings)


@pytest.mark.parametrize("name", ["figure-eight", "overhand-knot", "coil", "several"])
def test_no_finger_is_in_a_string_or_the_table(name: str) -> None:
    curves = make_scene(name, 2).curves
    chains, crossings = laid(curves)
    grasps, _ = grasps_of(*chains, crossings=crossings)
    assert len(grasps) > 20
    tree = KDTree(np.vstack([c.points for c in chains]))
    for grasp in grasps:
        fingers = finger_points(grasp)
        # 0.2 mm: the curves are polylines of 1 mm, and the balls leave notches of r / 30 in a string.
        assert tree.query(fingers)[0].min() > R + GRIPPER.clearance_m - 2e-4
        assert fingers[:, 2].min() - TABLE_Z == pytest.approx(grasp.table_clearance_m, abs=1e-9)
        assert grasp.table_clearance_m > GRIPPER.min_table_clearance_m - 1e-9
    assert {grasp.chain for grasp in grasps} == {c.id for c in chains}


def test_every_frame_is_a_rigid_transform_on_the_centre_line() -> None:
    scene = make_scene("overhand-knot", 1)
    grasps, _ = grasps_of(*laid(scene.curves)[0], crossings=laid(scene.curves)[1])
    for grasp in grasps:
        T = grasp.T_base_grasp
        np.testing.assert_allclose(T[:3, :3].T @ T[:3, :3], np.eye(3), rtol=0, atol=1e-9)
        assert np.linalg.det(T[:3, :3]) == pytest.approx(1, abs=1e-9)
        np.testing.assert_array_equal(T[3], (0, 0, 0, 1))
        # Chords of the 1 mm polyline.
        assert KDTree(scene.curves[0] + [0, 0, TABLE_Z]).query(T[:3, 3])[0] < 0.0006
