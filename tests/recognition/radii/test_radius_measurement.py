"""The radius from simulated scans of three noiseless views with pose errors, and the rough radius of half strings."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from cell.config.rendering_options import RenderingOptions
from cell.simulation.offline_scan import SimulatedScan, simulate
from cell.simulation.rendering.depth_camera import camera_model
from cell.simulation.scenes.clutter import Box
from cell.simulation.scenes.scenes import StringScene, make_scene
from recognition.errors import RadiusUnknownError
from recognition.ingestion.table_and_warp import TableAndWarp
from recognition.pipeline import recognise
from recognition.preprocessing.target_cloud import Scene
from recognition.radii.radius_measurement import PAPER_R, measure_radius
from recognition.radii.ridges import MAX_HEIGHT_M, estimate_rough_radius
from recognition.request import RecognitionRequest

WITHIN = 0.05
"""Relative tolerance: pose errors of the views make a string thicker by 0.1 to 0.3 mm."""


def scan_of(scene: StringScene) -> SimulatedScan:
    return simulate(scene, camera_model("exact", (320, 200)), 1, views=3)


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
    return measure_radius(TableAndWarp.measure(scan.views, Scene(0.0, scan.header.workspace_m))).radius_m


@pytest.mark.parametrize(("name", "r"), [("loop", 0.0025), ("arc", 0.007)])
def test_the_radius_is_measured(name: str, r: float) -> None:
    assert measured(make_scene(name, 1, radius_m=r)) == pytest.approx(r, rel=WITHIN)


@pytest.mark.parametrize(
    ("most", "rest"), [(0.003, 0.004), (0.004, 0.003), (0.003, 0.006), (0.006, 0.003)], ids=lambda r: f"{1000 * r:g}mm"
)
def test_of_several_radii_the_one_with_most_length_counts(most: float, rest: float) -> None:
    # 0.28 m against 0.22 m: the length counts, not the number of strings.
    assert measured(strings((0.11, rest), (0.28, most), (0.11, rest))) == pytest.approx(most, rel=WITHIN)


@pytest.mark.parametrize("order", [(0, 1, 2), (1, 2, 0), (2, 0, 1)])
def test_without_a_majority_it_is_the_median(order: tuple[int, int, int]) -> None:
    kinds = [(0.14, 0.0032), (0.13, 0.004), (0.14, 0.005)]
    assert measured(strings(*(kinds[k] for k in order))) == pytest.approx(0.004, rel=WITHIN)


def test_it_is_the_radius_of_the_fitted_tube_not_half_the_height() -> None:
    lying = make_scene("loop", 1)
    # 2 mm above the table it is 5.2 mm by its height.
    raised = replace(lying, curves=tuple(curve + np.array([0.0, 0.0, 0.002]) for curve in lying.curves))
    assert measured(raised) == pytest.approx(0.0042, rel=WITHIN)


@pytest.mark.parametrize("factor", [0.3, 0.5, 1.8, 2.5])
def test_a_string_that_a_wrong_radius_misses_is_a_doubt(factor: float) -> None:
    scan = scan_of(strings((0.2, 0.0042), (0.2, 0.0042)))
    model = recognise(
        scan.views, RecognitionRequest(radius_m=factor * 0.0042), Scene(0.0, scan.header.workspace_m)
    ).model
    assert model.chains == ()
    assert model.quality.verdict == "review"
    (found,) = [found for found in model.quality.findings if found.code == "string-of-other-radius"]
    assert found.value == pytest.approx(0.0042, rel=WITHIN)
    assert found.point_m is not None
    assert min(abs(found.point_m[1]), abs(found.point_m[1] - 0.03)) < 0.001  # on one of the two strings


@pytest.mark.parametrize("r", [0.0015, 0.0042, 0.012])
def test_a_table_without_a_string_gives_no_such_doubt(r: float) -> None:
    for boxes in ((), (Box((0.0, 0.0), (0.08, 0.05, 0.02), 0.2), Box((0.07, 0.06), (0.1, 0.006, 0.01), 1.0))):
        scan = scan_of(strings(boxes=boxes))
        model = recognise(scan.views, RecognitionRequest(radius_m=r), Scene(0.0, scan.header.workspace_m)).model
        assert not any(found.code == "string-of-other-radius" for found in model.quality.findings)


def test_for_a_bar_without_a_fitted_tube_it_is_half_the_height() -> None:
    bar = Box((0.0, 0.0), (0.2, 0.012, 0.010), 0.3)
    # 10 mm high, measured to 0.1 mm.
    assert measured(strings(boxes=(bar,))) == pytest.approx(0.005, abs=0.0001)


def test_for_an_empty_table_it_is_the_radius_of_the_paper() -> None:
    assert measured(strings()) == PAPER_R


def test_a_thin_string_is_refused() -> None:
    # 2.4 mm high: it is seen, but it is no higher than the noise of a table may be.
    with pytest.raises(RadiusUnknownError, match="give the radius"):
        measured(strings((0.3, 0.0012)))


def test_objects_other_than_strings_are_refused() -> None:
    plate = Box((0.0, 0.0), (0.1, 0.1, 0.010), 0.3)
    with pytest.raises(RadiusUnknownError, match="as high as it is wide"):
        measured(strings(boxes=(plate,)))


TABLE_Z = 0.3
"""Not 0, so that a height and a height above the table differ."""
STEP_M = 0.0007
"""Distance of the points seen: two of them in a cell of 1 mm."""
LOWEST_M = 0.0018
"""Height above the table from which points are used."""

Points = NDArray[np.float64]


def grid(length: float, width: float, step: float = STEP_M) -> tuple[Points, Points]:
    """X and y of even points on a rectangle about the origin."""
    x, y = np.meshgrid(np.arange(-length / 2, length / 2, step), np.arange(-width / 2 + step / 4, width / 2, step))
    return x.ravel(), y.ravel()


def placed(x: Points, y: Points, z: Points, degrees: float = 0.0, at: tuple[float, float] = (0.0, 0.0)) -> Points:
    """(N, 3) points at heights z above the table, turned about the vertical and then moved."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return np.column_stack([c * x - s * y + at[0], s * x + c * y + at[1], z + TABLE_Z])


def string(
    r: float, noise: float = 0.0, seed: int = 0, degrees: float = 0.0, z: float = 0.0, length: float = 0.2
) -> Points:
    """The upper half of a straight string whose lowest point is at z above the table; `noise` is one sigma."""
    x, y = grid(length, 2 * r)
    height = z + r + np.sqrt(r**2 - y**2)
    return placed(x, y, height + np.random.default_rng(seed).normal(0.0, noise, len(x)), degrees)


def table(noise: float) -> Points:
    """Points of a table of 400 mm by 400 mm that scatter above `LOWEST_M`."""
    x, y = grid(0.4, 0.4, 0.001)
    z = np.random.default_rng(1).normal(0.0, noise, len(x))
    high = z > LOWEST_M
    return placed(x[high], y[high], z[high])


def block(length: float, width: float, height: float, degrees: float = 0.0, noise: float = 0.0004) -> Points:
    """The top of a box, 90 mm beside the string."""
    x, y = grid(length, width)
    z = height + np.random.default_rng(2).normal(0.0, noise, len(x))
    return placed(x, y, z, degrees, at=(0.0, 0.09))


def off_the_middle(r: float) -> float:
    """Error of the radius of a string if its height is measured 1 mm, one cell, off its middle."""
    return (r - np.sqrt(r**2 - 0.001**2)) / 2


@pytest.mark.parametrize("degrees", [0, 37, 90])
@pytest.mark.parametrize("r", [0.002, 0.0042, 0.01, 0.019])
def test_half_the_height_of_a_string_is_its_radius(r: float, degrees: float) -> None:
    found = estimate_rough_radius([string(r, degrees=degrees)], TABLE_Z)
    # At most the highest point, up to rounding.
    assert r - off_the_middle(r) <= found <= r + 1e-12


@pytest.mark.parametrize("noise", [0.0003, 0.0006])
@pytest.mark.parametrize("r", [0.002, 0.0042, 0.01])
def test_noise_is_halved(r: float, noise: float) -> None:
    found = estimate_rough_radius([string(r, noise, seed) for seed in range(3)], TABLE_Z)
    # A cell's third highest of six points is off by less than a sigma, the radius by half of that.
    assert found == pytest.approx(r, abs=off_the_middle(r) + noise / 2)


def test_views_of_either_side_are_combined() -> None:
    whole = string(0.0042)
    left = whole[:, 1] > 0
    assert estimate_rough_radius([whole[left], whole[~left]], TABLE_Z) == estimate_rough_radius([whole], TABLE_Z)


@pytest.mark.parametrize("noise", [0.0007, 0.001, 0.0015])
def test_the_tables_noise_is_no_string(noise: float) -> None:
    r = 0.0042
    found = estimate_rough_radius([string(r, 0.0003), table(noise)], TABLE_Z)
    assert found == pytest.approx(r, abs=off_the_middle(r) + 0.0003)


@pytest.mark.parametrize("degrees", [0, 20, 45])
@pytest.mark.parametrize(
    ("length", "width", "height"), [(0.08, 0.08, 0.008), (0.2, 0.03, 0.06), (0.1, 0.1, 0.0042), (0.2, 0.1, 0.09)]
)
def test_an_object_beside_changes_nothing(length: float, width: float, height: float, degrees: float) -> None:
    r = 0.0042
    found = estimate_rough_radius([string(r), block(length, width, height, degrees)], TABLE_Z)
    # Few cells of an object are as wide as they are high: the median stays among the heights of the string.
    assert r - off_the_middle(r) <= found <= r * 1.01


def test_a_crossing_does_not_double_it() -> None:
    r = 0.0042
    over = string(r, degrees=90, z=2 * r, length=0.06)
    found = estimate_rough_radius([string(r), over], TABLE_Z)
    assert r - off_the_middle(r) <= found <= r * 1.01


def refusal(*clouds: Points) -> str:
    with pytest.raises(RadiusUnknownError) as refused:
        estimate_rough_radius(clouds, TABLE_Z)
    assert "give the radius" in str(refused.value)
    return str(refused.value)


def test_without_anything_in_view_the_radius_must_be_given() -> None:
    nothing = np.empty((0, 3))
    above = block(0.02, 0.02, MAX_HEIGHT_M + 0.01)
    for clouds in ((), (nothing,), (above,), (table(0.001),)):
        assert refusal(*clouds).startswith("no string in view")


def test_objects_too_far_apart_need_a_smaller_workspace() -> None:
    # 40 m apart, one along x and one along y.
    message = refusal(string(0.0042), string(0.0042) + (40.0, 0.0, 0.0), string(0.0042) + (0.0, 40.0, 0.0))
    size = [int(word) for word in message.split() if word.isdigit()]
    # Two cells of margin on either side.
    np.testing.assert_allclose(size, (40200, 40008), rtol=0, atol=5)
    assert "a smaller workspace" in message


@pytest.mark.parametrize("degrees", [0, 20, 45])
def test_without_anything_like_a_string_the_error_says_so(degrees: float) -> None:
    start = "nothing above the table is as high as it is wide"
    assert refusal(block(0.08, 0.08, 0.008, degrees)).startswith(start)
    # Too high for its width, too thick for any string, and many crumbs of a string.
    assert refusal(block(0.1, 0.005, 0.03, degrees)).startswith(start)
    assert refusal(string(0.025, degrees=degrees)).startswith(start)
    crumb = string(0.0042, degrees=degrees, length=0.012)
    assert refusal(*(crumb + (0.03 * k, 0.0, 0.0) for k in range(30))).startswith(start)


@pytest.mark.parametrize("r", [0.0035, 0.0055])
def test_the_radius_in_matched_depth_is_that_of_bands(r: float) -> None:
    options = RenderingOptions(sheath="woven", table_top="printed")
    scan = simulate(make_scene("loop", 1, radius_m=r), camera_model("oak-d-pro"), 1, views=4, rendering=options)
    measured = TableAndWarp.measure(scan.views, Scene(0.0, scan.header.workspace_m))
    assert measured.locking is not None
    # On a table with much texture, windows change the mean of height and width by up to 13 %.
    assert measure_radius(measured).radius_m == pytest.approx(r, rel=0.2)
