"""Bands of strings in a single view, their axes, and what they show of the matching of the depth."""

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import KDTree

from cell.devices import View
from cell.planning.look_at import Bearing
from cell.simulation.offline_scan import simulate
from cell.simulation.pose_errors import NO_ERRORS
from cell.simulation.rendering.depth_camera import camera_model
from cell.simulation.scenes.scenes import make_scene
from recognition.depth_correction.band_axes import PixelPairs, fit_axes
from recognition.depth_correction.string_bands import MIN_BORDER_BLUR_PX, StringBands, find_bands
from recognition.parameters import ChainParameters
from recognition.preprocessing.target_cloud import AlignedView, Scene, align_view

R = 0.0042
HEIGHT_M = 0.4
"""Height of the camera, which looks straight down."""
K = np.array([[420.0, 0, 159.5], [0, 420.0, 99.5], [0, 0, 1]])
SIZE = (200, 320)
R_PX = R * K[0, 0] / HEIGHT_M
WAVE_M = 0.02
"""Amplitude of the wave that the string lies in."""


def wave(x_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the position y of the string at positions x on the table, metres."""
    return WAVE_M * np.sin(x_m * 30)


def string_heights(r: float = R, lowered: float = 0.0, share: float = 0.5) -> NDArray[np.float64]:
    """Return the heights (H, W) of a resting string in a wave, seen from above, metres.

    Args:
        r: Radius of the string, metres.
        lowered: Share of the height that is lost in a part of each 60 mm along x.
        share: This part.
    """
    v, u = np.indices(SIZE)
    x, y = ((pixel - centre) * HEIGHT_M / K[0, 0] for pixel, centre in ((u, K[0, 2]), (v, K[1, 2])))
    line_x = np.arange(-0.1, 0.1, 0.0002)
    distance = np.min(np.hypot(x[..., None] - line_x[::5], y[..., None] - wave(line_x[::5])), axis=2)
    top = np.where(distance < r, r + np.sqrt(np.maximum(r**2 - distance**2, 0)), 0.0)
    return top * np.where((x / 0.06) % 1 < share, 1 - lowered, 1.0)


def view_of(heights: NDArray[np.float64]) -> View:
    """Return a view from straight above with heights (H, W) above the table, metres."""
    T_base_camera = np.diag([1.0, -1.0, -1.0, 1.0])
    T_base_camera[2, 3] = HEIGHT_M
    depth = np.rint((HEIGHT_M - heights) / 1e-5).astype(np.uint16)
    return View(0, depth, 1e-5, K, T_base_camera, np.eye(4), 0.0)


def aligned(heights: NDArray[np.float64], r: float = R) -> AlignedView:
    """Return the view of heights (H, W), aligned to the table for strings of a radius."""
    return align_view(view_of(heights), ChainParameters.for_radius(r), Scene())


def bands_of(heights: NDArray[np.float64], r: float = R) -> StringBands:
    """Return the bands in heights (H, W), which must have some."""
    bands = find_bands(aligned(heights, r))
    assert bands is not None
    return bands


def in_windows(heights: NDArray[np.float64], window_px: int = 5) -> NDArray[np.float64]:
    """Return heights (H, W) as windows of pixels mix them."""
    return ndimage.uniform_filter(heights, window_px)


@pytest.mark.parametrize("window_px", [1, 5])
def test_axes_are_the_middles_of_the_bands(window_px: int) -> None:
    bands = bands_of(in_windows(string_heights(), window_px))
    x = (bands.axis[:, 0] - K[0, 2]) * HEIGHT_M / K[0, 0]
    y = -(bands.axis[:, 1] - K[1, 2]) * HEIGHT_M / K[1, 1]
    # the rows of the image run against y, and the string is 2 r higher, which enlarges it by 2 %
    error_px = np.abs(-y - wave(x)) * K[0, 0] / HEIGHT_M
    # the distance along y is larger than that across a slanted axis: by 1.2 at most
    assert np.median(error_px) < 0.5
    assert np.percentile(error_px, 95) < 1.2
    assert np.ptp(x) > 0.17


def test_sharp_depth_does_not_shows_matching() -> None:
    bands = bands_of(string_heights())
    assert bands.compression == 1.0
    assert bands.border_blur_px() < 0.9
    assert not bands.shows_matching
    assert bands.lost_m < 0.1 * R


@pytest.mark.parametrize("window_px", [5, 7])
def test_windows_blur_the_borders(window_px: int) -> None:
    bands = bands_of(in_windows(string_heights(), window_px))
    assert bands.border_blur_px() > MIN_BORDER_BLUR_PX
    assert bands.shows_matching


def test_strings_that_are_too_low_in_places_shows_matching() -> None:
    bands = bands_of(string_heights(lowered=0.4))
    assert bands.is_uneven
    assert bands.shows_matching
    # The lowest tenth lost 40 % of 2 r.
    assert bands.lost_m == pytest.approx(0.4 * 2 * R, rel=0.1)


def test_an_object_that_is_low_everywhere_is_not_uneven() -> None:
    assert not bands_of(0.6 * string_heights()).is_uneven


def test_a_thinner_string_has_no_band() -> None:
    assert find_bands(aligned(string_heights(0.6 * R))) is None


def test_a_bare_table_has_no_band() -> None:
    assert find_bands(aligned(np.zeros(SIZE))) is None


@pytest.mark.parametrize("tilt_deg", [5, 30, 45])
def test_oblique_sharp_depth_shows_the_axis_and_no_matching(tilt_deg: float) -> None:
    scene = make_scene("arc", 2, R)
    bearing = Bearing(0.7, np.deg2rad(90 - tilt_deg), 0.3)
    camera = camera_model("exact", (1280, 800))
    (view,) = simulate(scene, camera, 1, errors=NO_ERRORS, views=1, bearings=[bearing]).views
    bands = find_bands(align_view(view, ChainParameters.for_radius(R), Scene()))
    assert bands is not None
    assert not bands.shows_matching
    T = view.T_base_camera
    pixels = (np.vstack(scene.curves) - T[:3, 3]) @ T[:3, :3] @ view.K.T
    line = pixels[:, :2] / pixels[:, 2:]
    distance, _ = KDTree(line).query(bands.axis)
    # points of the line are up to 2 pixels apart, which is 0.25 radii
    assert np.median(distance) < 0.1 * bands.r_px
    assert np.percentile(distance, 95) < 0.2 * bands.r_px


def test_slow_errors_of_the_table_are_those_of_the_string() -> None:
    error_m = 0.001 * np.sin(np.arange(SIZE[1]) / 60)[None]
    bands = bands_of(string_heights() + error_m)
    assert np.percentile(np.abs(bands.axis_tops_m - 2 * R), 90) < 0.0005


def test_an_axis_follows_an_arc_and_not_a_crossing() -> None:
    angle = np.linspace(0, 1.5, 60)
    arc = 40 * np.column_stack([np.cos(angle), np.sin(angle)])
    pairs = PixelPairs.within(arc, 12.0)
    axes = fit_axes(arc, pairs, 12.0)
    inner = slice(15, 45)
    assert axes.is_smooth(4.0)[inner].all()
    np.testing.assert_allclose(np.linalg.norm(axes.position[inner], axis=1), 40, atol=0.1)
    # half the curvature of a circle of 40 pixels
    np.testing.assert_allclose(np.abs(axes.curvature[inner]), 1 / 80, rtol=0.1)

    line = np.column_stack([np.arange(-30.0, 31.0), np.zeros(61)])
    cross = np.vstack([line, line[:, ::-1]])
    pairs = PixelPairs.within(cross, 12.0)
    smooth = fit_axes(cross, pairs, 12.0).is_smooth(4.0)
    assert not smooth[30]
    assert smooth[[10, 50]].all()


def test_the_median_of_pairs_is_that_of_the_near_pixels() -> None:
    points = np.array([(0.0, 0.0), (1.0, 0.0), (2.0, 0.0), (10.0, 0.0)])
    pairs = PixelPairs.within(points, 2.5)
    np.testing.assert_array_equal(pairs.median(np.array([1.0, 5.0, 3.0, 7.0])), [3.0, 3.0, 3.0, 7.0])
    np.testing.assert_array_equal(pairs.sum(np.ones(len(pairs.first))), [3.0, 3.0, 3.0, 1.0])
