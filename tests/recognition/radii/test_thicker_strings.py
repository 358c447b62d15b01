"""Strings that are much thicker than the given radius, on simulated scans without depth noise."""

from collections.abc import Sequence

import numpy as np
import pytest
from numpy.typing import NDArray

from cell.simulation.cases import make_case
from cell.simulation.evaluation.metrics import score
from cell.simulation.offline_scan import SimulatedScan, simulate
from cell.simulation.rendering.depth_camera import camera_model
from cell.simulation.scenes.clutter import Box
from cell.simulation.scenes.scenes import StringScene
from recognition.model.chains import Chain
from recognition.model.model import PointChainModel
from recognition.pipeline import recognise
from recognition.preprocessing.target_cloud import Scene
from recognition.request import RecognitionRequest

pytestmark = pytest.mark.slow

R = 0.0035
THICK_R = 2 * R


def arc(length_m: float, bend_m: float, y: float, r: float) -> NDArray[np.float64]:
    """Return a circular arc (N, 3) on the table, symmetric to the y axis. An infinite `bend_m` gives a line."""
    s = np.linspace(-length_m / 2, length_m / 2, round(length_m / 0.001) + 1)
    if np.isinf(bend_m):
        return np.column_stack([s, np.full(len(s), y), np.full(len(s), r)])
    angle = s / bend_m
    return np.column_stack([bend_m * np.sin(angle), y + bend_m * (1 - np.cos(angle)), np.full(len(s), r)])


def scan_of(scene: StringScene) -> SimulatedScan:
    return simulate(scene, camera_model("exact"), 1, views=4)


def model_of(
    curves: Sequence[NDArray[np.float64]], radii_m: Sequence[float], boxes: tuple[Box, ...] = ()
) -> PointChainModel:
    scan = scan_of(StringScene("strings", R, tuple(curves), boxes, radii_m=tuple(radii_m)))
    return recognise(scan.views, RecognitionRequest(radius_m=R), Scene(0.0, scan.header.workspace_m)).model


def codes(model: PointChainModel) -> set[str]:
    return {found.code for found in model.quality.doubts} - {"table-not-covered"}


def near(chain: Chain, curve: NDArray[np.float64]) -> bool:
    """Return whether a chain lies within 2 mm of a curve."""
    distance = np.linalg.norm(chain.points[:, None] - curve[None], axis=2).min(axis=1)
    return bool(distance.max() < 0.002)


THIN = arc(0.2, 0.1, 0.04, R)


@pytest.mark.parametrize("share", [2.0, 3.0])
def test_a_thicker_string_is_recognised_with_its_radius(share: float) -> None:
    thick = arc(0.35, 0.1, -0.1, share * R)
    model = model_of([THIN, thick], [R, share * R])
    assert len(model.chains) == 2
    (found,) = (chain for chain in model.chains if near(chain, thick))
    assert found.radius_m == pytest.approx(share * R, rel=0.05)
    assert found.length_m == pytest.approx(0.35, abs=0.004)
    assert codes(model) == set()


@pytest.mark.parametrize("seed", [5, 17])
def test_strings_of_several_radii_and_their_crossings_are_recognised(seed: int) -> None:
    scan = scan_of(make_case("mixed", seed).scene)
    assert max(scan.truth["radii"]) == pytest.approx(2 * scan.truth["radius"])
    model = recognise(
        scan.views, RecognitionRequest(radius_m=scan.truth["radius"]), Scene(0.0, scan.header.workspace_m)
    ).model
    result = score(model.to_json(), scan.truth)
    assert result.topology
    assert result.confident_mistakes == 0
    assert sorted(chain.radius_m for chain in model.chains) == pytest.approx(sorted(scan.truth["radii"]), rel=0.1)
    # The first pass traces lines on the surface of the thick string. They are no doubt about the result.
    assert codes(model) == set()


def test_a_straight_thick_strand_is_a_doubt_and_not_a_chain() -> None:
    rod = arc(0.2, np.inf, -0.06, THICK_R)
    model = model_of([THIN, rod], [R, THICK_R])
    assert len(model.chains) == 1
    assert near(model.chains[0], THIN)
    (doubt,) = (found for found in model.quality.doubts if found.code == "possible-string")
    assert "straight like a pen or a rod" in doubt.message


def test_a_thick_bar_is_not_a_chain() -> None:
    bar = Box((0.0, -0.06), (0.2, 2 * THICK_R, 2 * THICK_R), 0.0)
    model = model_of([THIN], [R], (bar,))
    assert len(model.chains) == 1
    assert near(model.chains[0], THIN)
    assert "unexplained-surface" in {found.code for found in model.quality.findings}


def test_without_a_string_of_the_given_radius_the_radius_is_doubted() -> None:
    model = model_of([arc(0.35, 0.1, -0.1, THICK_R)], [THICK_R])
    assert model.chains == ()
    assert "string-of-other-radius" in codes(model)
