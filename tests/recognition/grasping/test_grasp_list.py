"""The list of grasps on straight strings and a ring: order, clusters, distances, and what a lift meets."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from recognition.grasping.flange_poses import LIFT_M, flange_poses
from recognition.grasping.grasp_list import CLUSTER_M, list_grasps
from recognition.grasping.obstacles import gather_obstacles
from recognition.model.chains import Chain, ChainInterpolator, Crossing, StrandPoint
from recognition.model.grasps import Grasp, ScoredGrasp
from tests.recognition.straight_strings import GRIPPER, NOTHING, TABLE_Z, R, chain, grasps_of, straight

SPACING = 0.0015
"""Distance of the measured points of objects, metres."""
STRINGS = (straight(), straight(y=0.1, number=1))
"""Two strings of 0.2 m along x."""


def listed(
    *chains: Chain,
    crossings: Sequence[Crossing] = (),
    surface: np.ndarray = NOTHING,
    grasps: Sequence[ScoredGrasp] | None = None,
) -> tuple[Grasp, ...]:
    found = grasps_of(*chains)[0] if grasps is None else grasps
    return list_grasps(found, chains, crossings, gather_obstacles(chains, surface, SPACING), GRIPPER)


def crossing(over: tuple[int, float], under: tuple[int, float], confidence: float = 1.0) -> Crossing:
    return Crossing(0, np.zeros(3), StrandPoint(*over), StrandPoint(*under), 2 * R, np.pi / 2, 1, confidence)


def slab(x: tuple[float, float], y: tuple[float, float], z: tuple[float, float]) -> np.ndarray:
    """Return points (N, 3) that fill a box above the table, `SPACING` apart."""
    axes = [np.arange(low, high + SPACING / 2, SPACING) for low, high in (x, y, z)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3) + (0.0, 0.0, TABLE_Z)


def test_the_best_grasp_of_each_cluster_comes_first() -> None:
    grasps = listed(*STRINGS)
    assert [grasp.id for grasp in grasps] == list(range(len(grasps)))
    count = 1 + max(grasp.cluster for grasp in grasps)
    best, others = grasps[:count], grasps[count:]
    assert [grasp.cluster for grasp in best] == list(range(count))
    # 180 mm of each string can be grasped: at least 4.5 and at most 9 gaps of 20 to 40 mm fit in
    assert all(5 <= sum(grasp.chain == number for grasp in best) <= 10 for number in (0, 1))
    for part in (best, others):
        assert [grasp.score for grasp in part] == sorted((grasp.score for grasp in part), reverse=True)
    for one in best:
        gaps = [abs(one.s_m - other.s_m) for other in best if other is not one and other.chain == one.chain]
        assert min(gaps) >= CLUSTER_M
    for grasp in others:
        leader = best[grasp.cluster]
        assert (leader.chain, leader.score >= grasp.score) == (grasp.chain, True)
        assert abs(leader.s_m - grasp.s_m) < CLUSTER_M


def test_no_grasp_is_lost_or_changed() -> None:
    before = grasps_of(*STRINGS)[0]
    after = sorted(listed(*STRINGS), key=lambda grasp: (-grasp.score, grasp.chain, grasp.s_m))
    assert [(g.chain, g.s_m, g.score, g.clearance_m) for g in after] == [
        (g.chain, g.s_m, g.score, g.clearance_m) for g in before
    ]


def test_grasps_without_a_doubt_come_before_better_ones_with_a_doubt() -> None:
    marked = [replace(grasp, trusted=grasp.s_m > 0.1) for grasp in grasps_of(straight())[0]]
    grasps = listed(straight(), grasps=marked)
    count = 1 + max(grasp.cluster for grasp in grasps)
    for part in (grasps[:count], grasps[count:]):
        assert [grasp.trusted for grasp in part] == sorted((grasp.trusted for grasp in part), reverse=True)
    # a grasp with a doubt does not take the place of one without
    assert all(grasps[grasp.cluster].trusted for grasp in grasps if grasp.trusted)


def test_distances_along_the_string() -> None:
    grasps = listed(*STRINGS, crossings=(crossing((0, 0.05), (1, 0.12)),))
    for grasp in grasps:
        assert grasp.end_distance_m is not None
        np.testing.assert_allclose(grasp.end_distance_m, min(grasp.s_m, 0.2 - grasp.s_m), atol=1e-12)
        over, under = grasp.over_distance_m, grasp.under_distance_m
        if grasp.chain == 0:
            assert under is None
            assert over == pytest.approx(abs(grasp.s_m - 0.05), abs=1e-12)
        else:
            assert over is None
            assert under == pytest.approx(abs(grasp.s_m - 0.12), abs=1e-12)


def test_sigma_is_the_largest_between_the_fingers() -> None:
    line = straight()
    sigma = np.where(np.abs(line.arc_length_m - 0.1) < 0.003, 0.001, 0.0002)
    for grasp in listed(replace(line, sigma_m=sigma)):
        # beyond half a finger and a point spacing, none of the larger sigma is between the fingers
        if abs(grasp.s_m - 0.1) < 0.005:
            assert grasp.sigma_m == 0.001
        elif abs(grasp.s_m - 0.1) > 0.003 + 0.005 + 0.004:
            assert grasp.sigma_m == pytest.approx(0.0002, abs=1e-12)


def test_a_ring_has_no_end_and_distances_the_short_way_round() -> None:
    angle = np.linspace(0, 2 * np.pi, 120, endpoint=False)
    points = np.column_stack([0.1 * np.cos(angle), 0.1 * np.sin(angle), np.full(120, TABLE_Z + R)])
    ring = chain(points, closed=True)
    grasps = listed(ring, crossings=(crossing((1, 0.0), (0, 0.01)),))
    line = ChainInterpolator(ring)
    assert len(grasps) > 50
    for grasp in grasps:
        assert grasp.end_distance_m is None
        assert grasp.under_distance_m is not None
        assert grasp.under_distance_m <= ring.length_m / 2
        np.testing.assert_allclose(grasp.under_distance_m, line.distance(np.array(grasp.s_m), 0.01), atol=1e-12)
    best = [grasp.s_m for grasp in grasps[: 1 + max(grasp.cluster for grasp in grasps)]]
    gaps = line.distance(np.array(best)[:, None], np.array(best)) + np.eye(len(best))
    assert gaps.min() >= CLUSTER_M - 1e-12


def test_chains_above_are_those_that_a_lift_takes_along() -> None:
    certain = listed(*STRINGS, crossings=(crossing((0, 0.05), (1, 0.12)),))
    for grasp in certain:
        is_near = grasp.chain == 1 and abs(grasp.s_m - 0.12) <= LIFT_M
        assert grasp.chains_above == ((0,) if is_near else ())
    assert {grasp.chains_above for grasp in certain if grasp.chain == 1} == {(0,), ()}
    uncertain = listed(*STRINGS, crossings=(crossing((0, 0.05), (1, 0.12), confidence=0.6),))
    assert any(grasp.chains_above == (1,) for grasp in uncertain if grasp.chain == 0)


def test_an_object_above_the_string_limits_the_lift() -> None:
    shelf = slab((0.03, 0.05), (-0.03, 0.03), (0.034, 0.04))
    for grasp in listed(*STRINGS, surface=shelf):
        x_m = grasp.s_m - 0.1
        if grasp.chain == 0 and x_m > -0.025:  # the shelf begins within 60 mm
            assert grasp.object_above_m is not None
            # the lowest points are 34 mm above the table, and the string is r above it
            np.testing.assert_allclose(grasp.object_above_m, 0.034 - R, atol=SPACING)
        elif grasp.chain == 1 or x_m < -0.035:
            assert grasp.object_above_m is None


def test_what_stands_beside_the_string_or_above_the_lift_is_not_above_it() -> None:
    wall = slab((0.0, 0.1), (R, R + 0.01), (0.0, 0.05))
    ceiling = slab((-0.1, 0.1), (-0.02, 0.02), (LIFT_M + R + 0.005, LIFT_M + R + 0.008))
    for surface in (wall, ceiling):
        assert {grasp.object_above_m for grasp in listed(straight(), surface=surface)} == {None}


def test_each_grasp_has_its_flange_poses() -> None:
    for grasp in listed(*STRINGS):
        poses = flange_poses(grasp.T_base_grasp[None], [grasp.reach_m], GRIPPER)
        np.testing.assert_array_equal(grasp.T_base_flange.pregrasp, poses.pregrasp[0])
        np.testing.assert_array_equal(grasp.T_base_flange.grasp, poses.grasp[0])
        np.testing.assert_array_equal(grasp.T_base_flange.retreat, poses.retreat[0])


def test_without_grasps_the_list_is_empty() -> None:
    assert listed(straight(), grasps=()) == ()
