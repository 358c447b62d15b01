"""The search for strings of one radius: the same for the given radius, an unknown one, and thicker strings."""

from dataclasses import replace

import numpy as np
import pytest

from cell.simulation.offline_scan import SimulatedScan, simulate
from cell.simulation.rendering.depth_camera import camera_model
from cell.simulation.scenes.scenes import make_scene
from recognition.parameters import ChainParameters
from recognition.pipeline import recognise
from recognition.preprocessing.target_cloud import Scene
from recognition.request import RecognitionRequest
from recognition.strings import find_strings
from recognition.surface import Surface, observe
from recognition.tracing.occlusion_map import OcclusionMap

PARAMETERS = ChainParameters.for_radius(0.0042)


@pytest.fixture(scope="module")
def scan() -> SimulatedScan:
    return simulate(make_scene("loop", 1), camera_model("exact", (320, 200)), 1, views=3)


@pytest.fixture(scope="module")
def surface(scan: SimulatedScan) -> Surface:
    return observe(scan.views, Scene(0.0, scan.header.workspace_m), PARAMETERS)


def test_the_stages_begin_in_order(scan: SimulatedScan) -> None:
    begun: list[str] = []
    surface = observe(scan.views, Scene(0.0, scan.header.workspace_m), PARAMETERS, begin=begun.append)
    find_strings(surface, PARAMETERS, begin=begun.append)
    assert begun == ["registration", "centre_line", "matching", "refinement"]


def test_the_strings_are_those_of_the_recognition(scan: SimulatedScan, surface: Surface) -> None:
    found = find_strings(surface, PARAMETERS)
    recognition = recognise(scan.views, RecognitionRequest(radius_m=0.0042), Scene(0.0, scan.header.workspace_m))
    (string,), (chain,) = found.classified.strings, recognition.model.chains
    np.testing.assert_array_equal(string.points, chain.points)
    assert recognition.stages.graph is not None
    assert len(recognition.stages.graph.fragments) == len(found.traced.fragments)


def test_strings_are_found_without_the_depth_images(surface: Surface) -> None:
    """The measurement of a radius does so. Ends and gaps are then where the surface ends."""
    without_images = replace(surface, clouds=(), occlusion_map=OcclusionMap(surface.points))
    (string,) = find_strings(without_images, PARAMETERS).classified.strings
    (with_images,) = find_strings(surface, PARAMETERS).classified.strings
    # The ends differ by less than a radius, and the middle is fitted to the same surface.
    np.testing.assert_allclose(string.points[[0, -1]], with_images.points[[0, -1]], atol=0.0042)
    assert string.measured_radius_m == pytest.approx(with_images.measured_radius_m, rel=0.01)


def test_a_rough_radius_is_replaced_by_the_measured_one(surface: Surface) -> None:
    rough = ChainParameters.for_radius(0.0045)
    (given,) = find_strings(surface, rough).classified.strings
    (measured,) = find_strings(surface, rough, radius_is_given=False).classified.strings
    # Within 12 %, a given radius is believed.
    assert given.radius_m == 0.0045
    assert measured.radius_m == measured.measured_radius_m == pytest.approx(0.0042, rel=0.05)
