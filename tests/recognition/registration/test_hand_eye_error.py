"""The hand-eye error estimated from registered scans, against the error that was simulated."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from calibration.geometry.se3 import twist_from_pose
from calibration.geometry.transforms import from_rotation_vector, inverse
from calibration.verification.drift import ScanLikelihood, judge_drift
from cell.config.camera_config import SimulatedCamera
from cell.config.cell_config import CellSettings
from cell.devices import View
from cell.planning.viewpoints import ViewpointPlan, plan_viewpoints
from cell.simulation.devices.frame_source import FrameSource
from cell.simulation.devices.world import SimulatedWorld, simulated_world
from cell.simulation.scenes.scenes import make_scene
from recognition.ingestion.view_ingestion import IngestedViews, ingest_views
from recognition.parameters import ChainParameters
from recognition.preprocessing.normals import NormalCloud
from recognition.preprocessing.target_cloud import Scene
from recognition.registration.hand_eye_error import HandEyeErrorEstimate
from recognition.registration.pose_prior import PoseSigmas
from recognition.registration.registration import register

pytestmark = pytest.mark.slow

SCENES = ("figure-eight", "several", "straight")
PRIOR_COVARIANCE = np.diag(np.repeat([PoseSigmas().hand_eye_rad, PoseSigmas().hand_eye_m], 3) ** 2)
"""Covariance for a calibration whose file has none."""


@cache
def default_cell() -> tuple[SimulatedWorld, ViewpointPlan, Scene]:
    """The default simulated cell, with the robot and hand-eye errors of a good one."""
    settings = CellSettings(camera=SimulatedCamera(model="ideal"))
    world = simulated_world(settings)
    plan = plan_viewpoints(settings, world.nominal_T_flange_camera, None)
    return world, plan, Scene(settings.mounting.table_z_m, settings.workspace_m)


def ingested(scene: str, moved: tuple[float, ...]) -> IngestedViews:
    """Return the views of a scene after the camera `moved` (rotation vector, translation) since its calibration."""
    world, plan, where = default_cell()
    T_flange_camera = world.T_flange_camera @ from_rotation_vector(moved[3:], moved[:3])
    source = FrameSource(replace(world, scene=make_scene(scene, 1), T_flange_camera=T_flange_camera))
    K, unit, given = world.camera.K, world.camera.depth_unit_m, world.nominal_T_flange_camera
    views = [
        View(v.index, source.render_depth(v.T_base_flange), unit, K, v.T_base_flange, given)
        for v in plan.viewpoints
        if v.q_rad is not None
    ]
    return ingest_views(views, ChainParameters.for_radius(0.0042), where)


def estimate(views: IngestedViews, sigmas: PoseSigmas | None = None) -> HandEyeErrorEstimate:
    parameters = ChainParameters.for_radius(0.0042)
    error = register(views.clouds, parameters, views.correspondences, sigmas).hand_eye_error
    assert error is not None
    return error


def true_error(moved: tuple[float, ...]) -> np.ndarray:
    """Return the error (6,) of the given calibration, as `HandEyeErrorEstimate` defines it."""
    world, _, _ = default_cell()
    T = inverse(world.nominal_T_flange_camera) @ world.T_flange_camera @ from_rotation_vector(moved[3:], moved[:3])
    return twist_from_pose(T)


STILL = (0.0,) * 6
SHIFTED = (0.0, 0.0, 0.0, 0.003, 0.0, 0.0)
TURNED = (0.0, float(np.radians(0.5)), 0.0, 0.0, 0.0, 0.0)


@pytest.mark.parametrize("moved", [STILL, SHIFTED, TURNED], ids=["still", "shifted", "turned"])
def test_scans_show_a_camera_that_has_moved_and_no_other(moved: tuple[float, ...]) -> None:
    errors = [estimate(ingested(scene, moved)) for scene in SCENES]
    drift = judge_drift([ScanLikelihood(error.information, error.vector) for error in errors], PRIOR_COVARIANCE)
    assert drift.drifted == (moved != STILL)
    # The 3D sigmas of the mean over these scans are 0.9 mm and 0.17 degrees.
    off = drift.error - true_error(moved)
    assert np.linalg.norm(off[3:]) < 0.002
    assert np.linalg.norm(off[:3]) < np.radians(0.35)
    for error in errors:
        residual = error.vector - error.information @ true_error(moved)
        squared = residual @ np.linalg.solve(error.information, residual)
        # Chi square of 6 without a move (22 is exceeded once in a thousand); a larger move leaves fewer pairs.
        assert squared < (22 if moved == STILL else 45)


@pytest.mark.parametrize("scene", SCENES)
def test_a_camera_that_moved_towards_the_table_looks_like_another_table(scene: str) -> None:
    # All views are tilted alike, so a shift along the image's vertical raises or lowers the table in all of them.
    views = ingested(scene, (0.0, 0.0, 0.0, 0.0, 0.003, 0.0))
    assert views.moved_table is not None
    assert views.moved_table.height_m == pytest.approx(0.0026, abs=0.0003)
    assert views.moved_table.tilt_rad < np.radians(0.05)
    assert ingested(scene, STILL).moved_table is None
    assert ingested(scene, SHIFTED).moved_table is None


def test_the_prior_is_not_included() -> None:
    views = ingested("several", STILL)
    default, loose = estimate(views), estimate(views, PoseSigmas(hand_eye_m=0.004, hand_eye_rad=0.015))
    # The prior is a hundredth; correspondences and weights differ slightly.
    scale = np.sqrt(np.diag(default.information))
    np.testing.assert_allclose(
        loose.information / np.outer(scale, scale), default.information / np.outer(scale, scale), rtol=0, atol=0.15
    )
    np.testing.assert_allclose(loose.vector / scale, default.vector / scale, rtol=0, atol=0.5)
    # The corrections themselves depend on the prior.
    assert np.linalg.norm(default.posterior_mean[3:]) < np.linalg.norm(loose.posterior_mean[3:])
    assert np.linalg.eigvalsh(default.information).min() > 0


def test_views_without_overlap_give_no_estimate(table_1: ChainParameters, tube: Callable) -> None:
    s = np.arange(0.0, 0.2, 0.0008)
    line = np.column_stack([s, np.zeros_like(s), np.zeros_like(s)])
    clouds = []
    for k, height in enumerate((0.0, 0.1)):
        points, normals = tube(line, table_1.r, 0.2, 2.6, around=12)
        clouds.append(NormalCloud(k, points + (0, 0, height), normals, np.eye(4)))
    assert register(clouds, table_1).hand_eye_error is None
