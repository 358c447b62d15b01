"""Grasps of recognised models on the true scenes."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from cell.simulation.cases import TIERS, make_case, simulate
from cell.simulation.grasp_physics.judgement import judge_grasps, plan_on_truth
from cell.simulation.grasp_physics.settings import RobotError, robot_errors
from cell.simulation.grasp_physics.trial import PlannedGrasp
from cell.simulation.scenes.scenes import StringScene
from recognition.errors import RecognitionError
from recognition.geometry.polyline import arc_length
from recognition.grasping.gripper import Gripper
from recognition.model.model import PointChainModel
from recognition.pipeline import recognise
from recognition.preprocessing.target_cloud import Scene
from recognition.request import RecognitionRequest


def recognised(tier: str, seed: int) -> tuple[StringScene, PointChainModel]:
    case = make_case(tier, seed, "ideal")
    scan = simulate(case)
    scene = Scene(scan.header.table_z_m, scan.header.workspace_m)
    return case.scene, recognise(scan.views, RecognitionRequest(radius_m=scan.truth["radius"]), scene).model


def test_grasps_are_planned_on_their_true_string() -> None:
    scene, model = recognised("many", 0)
    planned = plan_on_truth(scene, model.chains, model.grasps)
    assert len(planned) == len(model.grasps) > 50
    assert {grasp.string for grasp in planned if grasp is not None} == set(range(len(scene.curves)))
    assert_on_their_strings(scene, planned)


@pytest.mark.parametrize("kept", [slice(0, 0.6), slice(0.4, 1)])
def test_grasps_of_an_incomplete_chain_are_planned_on_its_part_of_the_string(kept: slice) -> None:
    scene, model = recognised("paper", 0)
    (chain,) = model.chains
    part = slice(*(int(share * len(chain.points)) for share in (kept.start, kept.stop)))
    start_m = arc_length(chain.points)[part][0]
    incomplete = replace(chain, points=chain.points[part], sigma_m=chain.sigma_m[part], views=chain.views[part])
    grasps = [
        replace(grasp, s_m=grasp.s_m - start_m)
        for grasp in model.grasps
        if start_m <= grasp.s_m <= start_m + incomplete.length_m
    ]
    assert len(grasps) > 5
    assert_on_their_strings(scene, plan_on_truth(scene, [incomplete], grasps))


def assert_on_their_strings(scene: StringScene, planned: Sequence[PlannedGrasp | None]) -> None:
    """Assert that each grasp is where the true string is at its arc length."""
    for grasp in planned:
        assert grasp is not None
        curve = scene.curves[grasp.string]
        s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(curve, axis=0), axis=1))])
        true = np.array([np.interp(grasp.s_m, s, curve[:, axis]) for axis in range(3)])
        # The points of a curve are 1 mm apart, and the mean error of a chain is below 0.5 mm.
        assert np.linalg.norm(true - grasp.T_base_grasp[:3, 3]) < 0.0015


def test_a_grasp_of_a_chain_without_a_string_has_no_result() -> None:
    scene, model = recognised("paper", 0)
    strange = replace(model.grasps[0], chain=99)
    (judged,) = judge_grasps(scene, model.chains, [strange], Gripper())
    assert (judged.planned, judged.outcome, judged.clearance, judged.good) == (None, None, None, False)


def test_only_chosen_grasps_are_simulated() -> None:
    scene, model = recognised("paper", 0)
    shifted = RobotError("aside", across_m=0.03)
    judged = judge_grasps(
        scene, model.chains, model.grasps, Gripper(), simulated=[0, 3], errors=[shifted], with_errors=[3]
    )
    assert [grasp.rank for grasp in judged if grasp.outcome is not None] == [0, 3]
    assert [grasp.rank for grasp in judged if grasp.with_errors] == [3]
    assert judged[0].good
    assert judged[0].good_with_errors
    assert judged[3].good
    assert not judged[3].good_with_errors, "30 mm aside there is no string"
    assert all(grasp.clearance is not None for grasp in judged)


@pytest.mark.parametrize("tier", ["paper", "many", "soft", "photo"])
def test_the_best_grasp_holds_the_right_string(tier: str) -> None:
    scene, model = recognised(tier, 1)
    best = judge_grasps(scene, model.chains, model.grasps, Gripper(), simulated=[0])[0]
    assert best.good
    assert best.outcome is not None
    assert not best.outcome.touches_more()
    assert best.clearance is not None
    assert best.clearance.is_clean


@pytest.mark.soak
@pytest.mark.timeout(14400)
@pytest.mark.parametrize("tier", TIERS)
def test_nearly_all_grasps_hold_the_right_string(tier: str) -> None:
    best, top, every, disturbed = [], [], [], []
    for seed in range(40):
        try:
            scene, model = recognised(tier, seed)
        except RecognitionError:
            assert tier in ("measured", "noise")
            continue
        judged = judge_grasps(scene, model.chains, model.grasps, Gripper(), errors=robot_errors(), with_errors=range(1))
        good = [grasp.good for grasp in judged]
        best += good[:1]
        top += good[:5]
        every += good
        disturbed += [grasp.good_with_errors for grasp in judged[:1]]
    assert np.mean(best) >= 0.995
    assert np.mean(top) >= 0.995
    assert np.mean(every) >= 0.99
    assert np.mean(disturbed) >= 0.97
