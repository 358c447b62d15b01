"""Any depth images and poses give a valid model, or an error that says what to do."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from cell.simulation.offline_scan import SimulatedScan, simulate
from cell.simulation.rendering.depth_camera import camera_model
from cell.simulation.scenes.scenes import make_scene
from recognition.model.model import METHODS, Method, PointChainModel
from recognition.preprocessing.target_cloud import Scene
from recognition.request import RecognitionRequest
from tests.recognition.odd_scans import FAULTS, POSES, Case, Image, cases
from tests.recognition.validity import check

pytestmark = pytest.mark.slow

ANY_INPUT = settings(
    derandomize=True,
    database=None,
    deadline=None,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large, HealthCheck.function_scoped_fixture],
)


@pytest.mark.parametrize(("kind", "examples"), [("strings", 30), ("any", 60), ("chaos", 30)])
def test_any_images_and_poses_give_a_valid_model_or_a_refusal(kind: str, examples: int) -> None:
    @settings(ANY_INPUT, max_examples=examples)
    @given(cases(kind=kind))
    def holds(case: Case) -> None:
        check(case)

    holds()


@pytest.fixture(scope="module")
def scan() -> SimulatedScan:
    return simulate(make_scene("loop", 1), camera_model("exact", (320, 200)), 1, views=3)


@settings(ANY_INPUT, max_examples=12)
@example(seed=0, share=0.0, poses=POSES, radius=0.0042, method="graph")
@example(seed=0, share=0.0, poses=POSES, radius=0.0042, method="enhanced")
@given(
    seed=st.integers(0, 2**32),
    share=st.sampled_from((0.3, 1.0, 0.0)),
    poses=st.sampled_from((POSES[:2], POSES[:3], POSES)),
    radius=st.sampled_from((0.0042, None, 0.002, 0.008)),
    method=st.sampled_from(METHODS),
)
def test_a_scan_with_faults_put_in_gives_a_valid_model_or_a_refusal(
    scan: SimulatedScan,
    seed: int,
    share: float,
    poses: tuple[Callable[[Image, np.random.Generator], Image], ...],
    radius: float | None,
    method: Method,
) -> None:
    rng = np.random.default_rng(seed)
    views = []
    for view in scan.views:
        depth, T = view.depth, view.T_base_flange
        if rng.random() < share:
            depth = FAULTS[rng.integers(len(FAULTS))](depth, rng)
        if rng.random() < share:
            T = poses[rng.integers(len(poses))](T, rng)
        views.append(replace(view, depth=depth, T_base_flange=T))
    answer = check(Case(tuple(views), RecognitionRequest(method, radius), Scene(0.0, scan.header.workspace_m)))
    if share == 0.0 and radius == 0.0042:
        # Without faults there is a model: the validator sees whole models, and errors are due to the faults.
        assert isinstance(answer, PointChainModel)
        assert answer.chains
