"""Round tubes and square bars, distinguished by their profiles."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from cell.simulation.offline_scan import simulate
from cell.simulation.rendering.depth_camera import camera_model
from cell.simulation.scenes.clutter import Box
from cell.simulation.scenes.scenes import StringScene
from recognition.pipeline import recognise
from recognition.preprocessing.target_cloud import Scene
from recognition.refinement.cross_section import MIN_SECTIONS, SECTION_LINKS, CrossSections, measure_cross_sections
from recognition.refinement.tube_fit import TubeFit
from recognition.request import RecognitionRequest

R = 0.0042
STEP = 0.003
Surface = tuple[np.ndarray, np.ndarray]


def bar(length: float, noise: float = 0.0, seed: int = 0) -> Surface:
    """Top and sides, points and normals, of a bar of 2 r by 2 r on the table along the x axis, points 1 mm apart."""
    along, across = np.arange(0, length, 0.001), np.linspace(-R, R, 9)
    top = [((x, y, 2 * R), (0, 0, 1)) for x in along for y in across]
    sides = [((x, side * R, R + z), (0, side, 0)) for x in along for z in across[2:] for side in (-1, 1)]
    points, normals = (np.array(values, dtype=np.float64) for values in zip(*(top + sides), strict=True))
    return points + np.random.default_rng(seed).normal(0, noise, (len(points), 1)) * normals, normals


def measured(surface: Surface, *lines: np.ndarray, r: float = R) -> CrossSections:
    fit = TubeFit(lines, r, *surface)
    return measure_cross_sections(fit, fit.assign())


@pytest.mark.parametrize(("r", "offset"), [(R, (0, 0)), (0.9 * R, (0, 0)), (1.1 * R, (0, 0)), (R, (0.05, -0.08))])
def test_a_tube_is_round_although_its_radius_or_position_is_a_little_wrong(
    seen: Callable, straight: Callable, r: float, offset: tuple[float, float]
) -> None:
    surface = seen([straight((0, 0, R), (0.1, 0, R))])
    line = straight((0, 0, R), (0.1, 0, R), STEP) + R * np.array([0, *offset])
    found = measured(surface, line, r=r)
    # To first order both are among what is fitted; some 0.1 squared is left.
    assert abs(found.squareness[0]) < 0.03
    assert found.squareness_sigma[0] < 0.03


def test_a_bar_is_square(straight: Callable) -> None:
    found = measured(bar(0.1), straight((0, 0, R), (0.1, 0, R), STEP))
    # Its faces are exactly what is fitted.
    assert found.squareness[0] == pytest.approx(1.0, abs=0.02)
    assert found.roundness_error_m[0] > 0.05 * R


@pytest.mark.parametrize("noise", [0.05, 0.2])
def test_noise_does_not_make_a_tube_a_bar_and_sigma_covers_it(seen: Callable, straight: Callable, noise: float) -> None:
    axis = straight((0, 0, R), (0.1, 0, R))
    found = [measured(seen([axis], noise=noise * R, seed=seed), axis[::3]) for seed in range(30)]
    squareness = np.array([each.squareness[0] for each in found])
    z = squareness / np.array([each.squareness_sigma[0] for each in found])
    # Hardly a bias, and far from what makes a bar.
    assert abs(squareness.mean()) < 0.1
    # Of 30 the spread comes out within a quarter of itself; a sigma from six sections scatters as much again.
    assert 0.6 < z.std() < 1.7


def test_each_line_is_measured_by_itself(seen: Callable, straight: Callable) -> None:
    string = straight((0, 0.05, R), (0.1, 0.05, R))
    points, normals = (np.vstack(parts) for parts in zip(seen([string]), bar(0.1), strict=True))
    found = measured((points, normals), string[::3], straight((0, 0, R), (0.1, 0, R), STEP))
    np.testing.assert_allclose(found.squareness, (0, 1), rtol=0, atol=0.02)
    assert found.roundness_error_m[0] < 0.01 * R


def test_too_little_surface_gives_no_measure(seen: Callable, straight: Callable) -> None:
    links = SECTION_LINKS * (MIN_SECTIONS - 1)
    line = straight((0, 0, R), (links * STEP, 0, R), STEP)
    found = measured(seen([straight((0, 0, R), (0.1, 0, R))]), line)
    assert (found.squareness[0], found.squareness_sigma[0]) == (0.0, np.inf)
    # A wall: only one side of the profile is seen.
    points, normals = bar(0.1)
    one_side = (normals[:, 1] > 0) | (points[:, 1] > 0.8 * R)
    found = measured((points[one_side], normals[one_side]), straight((0, 0, R), (0.1, 0, R), STEP))
    assert found.roundness_error_m[0] == R


def test_a_square_bar_seen_from_afar_is_no_string() -> None:
    # Depth scatters by a fifth of its half width, as in a cell whose camera keeps 0.6 m away.
    camera = replace(camera_model("ideal"), working_m=(0.6, 0.62))
    scene = StringScene("bar", R, (), (Box((0.0, 0.0), (0.28, 0.0066, 0.0075), 0.6),))
    scan = simulate(scene, camera, 3)
    model = recognise(scan.views, RecognitionRequest(radius_m=R), Scene(0.0, scan.header.workspace_m)).model
    assert model.chains == ()
    # From this distance, the squareness is too uncertain to exclude a string.
    assert any(found.code in ("piece-not-round", "possible-string") for found in model.quality.findings)
