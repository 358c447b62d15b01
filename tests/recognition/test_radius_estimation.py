"""The radius measured from small simulated scans of three noiseless views whose poses are off."""

from dataclasses import replace

import numpy as np
import pytest

from cell.simulation.camera import camera_model
from cell.simulation.clutter import Box
from cell.simulation.scenes import StringScene, make_scene
from cell.simulation.simulate import SimulatedScan, simulate
from recognition.preprocessing.target_cloud import Scene
from recognition.radius_estimation import PAPER_R, estimate_parameters
from recognition.rough_radius import RadiusUnknownError

WITHIN = 0.05
"""Of the radius: 0.1 to 0.3 mm, by which views whose poses are off make a string thicker."""


def scan_of(scene: StringScene) -> SimulatedScan:
    return simulate(scene, camera_model("ideal", (320, 200)), 1, views=3)


def strings(*lengths_and_radii: tuple[float, float], boxes: tuple[Box, ...] = ()) -> StringScene:
    """Straight strings side by side, 30 mm from one to the next."""
    curves = []
    for k, (length, r) in enumerate(lengths_and_radii):
        x = np.linspace(-length / 2, length / 2, round(length / 0.001) + 1)
        curves.append(np.column_stack([x, np.full(len(x), 0.03 * k), np.full(len(x), r)]))
    radii = tuple(r for _, r in lengths_and_radii)
    return StringScene("side-by-side", radii[0] if radii else PAPER_R, tuple(curves), boxes, radii_m=radii)


def measured(scene: StringScene) -> float:
    scan = scan_of(scene)
    return estimate_parameters(scan.views, Scene(0.0, scan.header.workspace_m)).r


@pytest.mark.parametrize(("name", "r"), [("loop", 0.0025), ("arc", 0.007)])
def test_the_radius_is_measured(name: str, r: float) -> None:
    assert measured(make_scene(name, 1, radius_m=r)) == pytest.approx(r, rel=WITHIN)


@pytest.mark.parametrize(
    ("most", "rest"), [(0.003, 0.004), (0.004, 0.003), (0.003, 0.006), (0.006, 0.003)], ids=lambda r: f"{1000 * r:g}mm"
)
def test_of_several_radii_that_of_most_string_is_taken(most: float, rest: float) -> None:
    # 0.28 m against 0.22 m: more of length, not of strings.
    assert measured(strings((0.11, rest), (0.28, most), (0.11, rest))) == pytest.approx(most, rel=WITHIN)


@pytest.mark.parametrize("order", [(0, 1, 2), (1, 2, 0), (2, 0, 1)])
def test_where_none_has_most_it_is_the_median(order: tuple[int, int, int]) -> None:
    kinds = [(0.14, 0.0032), (0.13, 0.004), (0.14, 0.005)]
    assert measured(strings(*(kinds[k] for k in order))) == pytest.approx(0.004, rel=WITHIN)


def test_it_is_the_fitted_tubes_radius_not_half_the_height() -> None:
    lying = make_scene("loop", 1)
    # 2 mm above the table it is 5.2 mm by its height.
    raised = replace(lying, curves=tuple(curve + np.array([0.0, 0.0, 0.002]) for curve in lying.curves))
    assert measured(raised) == pytest.approx(0.0042, rel=WITHIN)


def test_of_a_bar_where_no_tube_fits_it_is_half_the_height() -> None:
    bar = Box((0.0, 0.0), (0.2, 0.012, 0.010), 0.3)
    # 10 mm high, seen to a tenth.
    assert measured(strings(boxes=(bar,))) == pytest.approx(0.005, abs=0.0001)


def test_of_an_empty_table_it_is_the_papers() -> None:
    assert measured(strings()) == PAPER_R


def test_a_thin_string_is_refused() -> None:
    # 2.4 mm high: it is seen, but is no higher than a table's noise may be.
    with pytest.raises(RadiusUnknownError, match="give the radius"):
        measured(strings((0.3, 0.0012)))


def test_things_that_are_no_string_are_refused() -> None:
    plate = Box((0.0, 0.0), (0.1, 0.1, 0.010), 0.3)
    with pytest.raises(RadiusUnknownError, match="as high as it is wide"):
        measured(strings(boxes=(plate,)))
