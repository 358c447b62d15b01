"""Compressed heights of strings are measured on their ridges and restored."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from cell.devices import View
from cell.simulation.offline_scan import SimulatedScan, simulate
from cell.simulation.pose_errors import NO_ERRORS
from cell.simulation.rendering.depth_camera import camera_model
from cell.simulation.scenes.clutter import Box
from cell.simulation.scenes.scenes import StringScene, make_scene
from recognition.depth_correction.depth_warp import CorrectedView
from recognition.depth_correction.height_compression import (
    MIN_RIDGES,
    Ridges,
    estimate_compression,
    estimate_radius,
    find_ridges,
    restore_heights,
)
from recognition.parameters import ChainParameters
from recognition.preprocessing.target_cloud import AlignedView, Scene, align_view

Image = NDArray[np.float64]

R = 0.0042
COMPRESSION = 0.7
HALF_BOX_M = 0.03
BOX = Box((0.0, 0.08), (2 * HALF_BOX_M, 2 * HALF_BOX_M, 0.03), 0.0)
"""Box beside a string along x. It is seven times as wide as the string."""


def scan_of(scene: StringScene) -> SimulatedScan:
    return simulate(scene, camera_model("exact", (320, 200)), 1, errors=NO_ERRORS, views=4)


@pytest.fixture(scope="module")
def beside_box() -> SimulatedScan:
    """A straight string along x, and a box."""
    x = np.arange(-0.15, 0.1501, 0.001)
    curve = np.column_stack([x, np.zeros(len(x)), np.full(len(x), R)])
    return scan_of(StringScene("beside-box", R, (curve,), (BOX,)))


def aligned_views(scan: SimulatedScan, views: list[View], r: float = R) -> list[AlignedView]:
    """Return the views aligned to the table for strings with a given radius."""
    scene = Scene(scan.header.table_z_m, scan.header.workspace_m)
    return [align_view(view, ChainParameters.for_radius(r), scene) for view in views]


def ridges_of(scan: SimulatedScan, compression: float = 1.0, r: float = R) -> list[Ridges]:
    """Return the ridges of all views with compressed heights, for strings with a given radius."""
    views = [compressed(view, compression) for view in scan.views]
    return [find_ridges(aligned) for aligned in aligned_views(scan, views, r)]


def descent(view: View | CorrectedView) -> Image:
    """Return the descent (H, W) of the line of sight of each pixel per metre of depth."""
    rows, columns = np.indices(view.depth.shape)
    rays = np.stack([columns, rows, np.ones(view.depth.shape)], axis=2) @ np.linalg.inv(view.K).T
    return -(rays @ view.T_base_camera[2, :3])


def heights(view: View | CorrectedView) -> Image:
    """Return the height (H, W) of each pixel above the table, metres."""
    return view.T_base_camera[2, 3] - descent(view) * view.depth * view.depth_unit_m


def positions(view: View) -> Image:
    """Return the position (H, W, 2) of each pixel on the table, metres."""
    rows, columns = np.indices(view.depth.shape)
    rays = np.stack([columns, rows, np.ones(view.depth.shape)], axis=2) @ np.linalg.inv(view.K).T
    points = (view.depth * view.depth_unit_m)[..., None] * (rays @ view.T_base_camera[:3, :3].T)
    return (points + view.T_base_camera[:3, 3])[..., :2]


def is_box(view: View, margin_m: float = 0.0) -> NDArray[np.bool_]:
    """Return which pixels (H, W) show the box, or something at most a margin beside it."""
    return np.all(np.abs(positions(view) - BOX.centre_m) < HALF_BOX_M + margin_m, axis=2)


def compressed(view: View, compression: float, kept: NDArray[np.bool_] | None = None) -> View:
    """Return the view with compressed heights, as windows of a stereo camera see them.

    Each point moves along its line of sight. A point above 2 r loses as much as one at 2 r. Pixels in the mask `kept`
    (H, W) stay.
    """
    lost_m = (1 - compression) * np.clip(heights(view), 0.0, 2 * R)
    if kept is not None:
        lost_m[kept] = 0.0
    depth_m = view.depth * view.depth_unit_m + lost_m / descent(view)
    depth = np.where(view.depth > 0, np.rint(depth_m / view.depth_unit_m), 0)
    return replace(view, depth=depth.astype(np.uint16))


@pytest.mark.parametrize("name", ["arc", "loop", "overhand-knot"])
@pytest.mark.parametrize("seed", [1, 2])
def test_exact_heights_are_not_compressed(name: str, seed: int) -> None:
    assert estimate_compression(ridges_of(scan_of(make_scene(name, seed))), R) == 1.0


@pytest.mark.parametrize("name", ["arc", "loop", "overhand-knot"])
@pytest.mark.parametrize("compression", [0.55, 0.7, 0.85])
def test_compression_is_measured(name: str, compression: float) -> None:
    # Half widths of a few pixels are measured up to 5 % too small, which raises heights as much. Blur lowers them 1 %.
    measured = estimate_compression(ridges_of(scan_of(make_scene(name, 1)), compression), R)
    assert measured == pytest.approx(compression, abs=0.05)


@pytest.mark.parametrize("name", ["straight", "loop", "overhand-knot"])
def test_thinner_strings_are_not_compressed(name: str) -> None:
    # Their height is 0.71 of the given one, and so is their width.
    assert estimate_compression(ridges_of(scan_of(make_scene(name, 1)), r=1.4 * R), 1.4 * R) == 1.0


def test_a_box_is_not_a_compressed_string(beside_box: SimulatedScan) -> None:
    assert estimate_compression(ridges_of(beside_box), R) == 1.0
    views = [compressed(view, COMPRESSION, is_box(view, 0.001)) for view in beside_box.views]
    ridges = [find_ridges(aligned) for aligned in aligned_views(beside_box, views)]
    assert estimate_compression(ridges, R) == pytest.approx(COMPRESSION, abs=0.05)


def test_a_scene_without_strings_is_not_compressed() -> None:
    table = scan_of(StringScene("table", R, ()))
    assert all(len(ridges.xy) == 0 for ridges in ridges_of(table))
    assert estimate_compression(ridges_of(table), R) == 1.0
    box = scan_of(StringScene("box", R, (), (BOX,)))
    assert estimate_compression(ridges_of(box), R) == 1.0


def test_few_ridges_show_no_compression() -> None:
    # Each of two views confirms those of the other, so all count twice.
    x = np.linspace(0.0, 0.1, MIN_RIDGES // 2)
    ridges = Ridges(np.column_stack([x, 0 * x]), np.full(len(x), COMPRESSION), np.ones(len(x)))
    assert estimate_compression([ridges, ridges], R) == pytest.approx(COMPRESSION, abs=0.01)
    fewer = Ridges(ridges.xy[1:], ridges.height[1:], ridges.half_width[1:])
    assert estimate_compression([fewer, fewer], R) == 1.0
    assert estimate_compression([], R) == 1.0


def test_ridges_that_one_view_shows_do_not_count() -> None:
    x = np.linspace(0.0, 0.1, 50)
    shown = Ridges(np.column_stack([x, 0 * x]), np.full(len(x), COMPRESSION), np.ones(len(x)))
    elsewhere = [replace(shown, xy=shown.xy + (0, 0.02 * k)) for k in range(4)]
    assert estimate_compression(elsewhere, R) == 1.0


@pytest.mark.parametrize("compared", [0.8, 1.0, 1.25])
@pytest.mark.parametrize(("height", "half_width"), [(1.0, 1.0), (0.7, 1.0), (1.0, 1.3), (0.8, 0.9)])
def test_the_radius_is_between_half_the_height_and_half_the_width(
    compared: float, height: float, half_width: float
) -> None:
    x = np.linspace(0.0, 0.1, MIN_RIDGES)
    shown = np.full(len(x), height / compared), np.full(len(x), half_width / compared)
    ridges = Ridges(np.column_stack([x, 0 * x]), *shown)
    radius = estimate_radius([ridges, ridges], compared * R)
    assert radius is not None
    # The height is known to half a bin of 0.01.
    assert min(height, half_width) - 0.01 <= radius / R <= max(height, half_width) + 0.01
    fewer = Ridges(ridges.xy[:10], ridges.height[:10], ridges.half_width[:10])
    assert estimate_radius([fewer, fewer], compared * R) is None


def test_heights_of_strings_are_restored(beside_box: SimulatedScan) -> None:
    for view in beside_box.views:
        low = compressed(view, COMPRESSION, is_box(view, 0.001))
        restored = restore_heights(aligned_views(beside_box, [low])[0], COMPRESSION)
        assert restored.depth_unit_m <= view.depth_unit_m
        # In the original view, these pixels are on the ridge: 0.3 r beside it, the string is 2 % lower than 2 r.
        xy = positions(view)
        is_ridge = (np.abs(xy[..., 1]) < 0.3 * R) & (np.abs(xy[..., 0]) < 0.14) & (heights(view) > 1.5 * R)
        assert is_ridge.sum() > 50
        assert np.median(heights(low)[is_ridge]) == pytest.approx(COMPRESSION * 2 * R, rel=0.05)
        np.testing.assert_allclose(heights(restored)[is_ridge], 2 * R, rtol=0.05)


def test_the_table_and_a_wide_box_stay(beside_box: SimulatedScan) -> None:
    for view in beside_box.views:
        low = compressed(view, COMPRESSION, is_box(view, 0.001))
        restored = restore_heights(aligned_views(beside_box, [low])[0], COMPRESSION)
        change_m = np.abs(heights(restored) - heights(low))
        is_shown = low.depth > 0
        is_on_box = is_box(view) & (heights(view) > R) & is_shown
        is_table = (heights(view) < view.depth_unit_m) & is_shown
        assert is_on_box.sum() > 500
        assert is_table.sum() > 10000
        # Wide objects are found on every fourth pixel, 2 mm apart, so a few pixels at the corners may be missed.
        is_inside = is_on_box & is_box(view, -0.008)
        assert change_m[is_inside].max() <= view.depth_unit_m
        assert (change_m[is_on_box] <= view.depth_unit_m).mean() > 0.98
        # Depths are rounded to the unit. On the table, this is the only height, which is enlarged by 0.4.
        assert change_m[is_table].max() <= view.depth_unit_m


def test_a_string_on_another_gains_as_much_as_a_resting_one() -> None:
    scan = scan_of(make_scene("loop", 1))
    for view in scan.views:
        low = compressed(view, COMPRESSION)
        restored = restore_heights(aligned_views(scan, [low])[0], COMPRESSION)
        is_upper = heights(view) > 3 * R
        assert is_upper.any()
        # Three roundings to half a unit, two of them enlarged by 1 / 0.7, and an alignment to less than half a unit.
        error_m = heights(restored) - heights(view)
        assert np.abs(error_m[view.depth > 0]).max() < 2.5 * view.depth_unit_m


def test_pixels_without_depth_stay_without_depth(beside_box: SimulatedScan) -> None:
    view = beside_box.views[0]
    depth = view.depth.copy()
    depth[80:100, 100:200] = 0
    restored = restore_heights(aligned_views(beside_box, [replace(view, depth=depth)])[0], COMPRESSION)
    np.testing.assert_array_equal(restored.depth > 0, depth > 0)
