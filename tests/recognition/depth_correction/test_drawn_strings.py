"""Strings are drawn into the images of a single viewpoint where windows took their height."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from cell.config.rendering_options import RenderingOptions
from cell.simulation.evaluation.metrics import score
from cell.simulation.offline_scan import SimulatedScan, simulate
from cell.simulation.rendering.depth_camera import camera_model
from cell.simulation.scenes.scenes import make_scene
from recognition.depth_correction.drawn_strings import draw_into_views, draw_strings
from recognition.depth_correction.pixel_heights import heights_above_table
from recognition.ingestion.view_ingestion import ingest_views
from recognition.parameters import ChainParameters
from recognition.pipeline import recognise
from recognition.preprocessing.target_cloud import Scene, align_view
from recognition.request import RecognitionRequest
from tests.recognition.depth_correction.test_string_bands import (
    R,
    aligned,
    bands_of,
    in_windows,
    string_heights,
    view_of,
)

P = ChainParameters.for_radius(R)


def drawn_heights(heights: NDArray[np.float64]) -> NDArray[np.float32]:
    """Return the heights (H, W) of the image with drawn strings, metres."""
    view = aligned(heights)
    return heights_above_table(replace(view, view=draw_strings(view, bands_of(heights))), 1)


@pytest.mark.parametrize(("lowered", "share"), [(0.0, 0.5), (0.3, 0.3), (0.3, 0.7), (0.4, 0.75)])
def test_windows_and_lost_heights_are_undone(lowered: float, share: float) -> None:
    """The surface within 0.8 r of the axis is that of the tube, although the measured one is up to 40 % too low."""
    true = string_heights()
    measured = in_windows(string_heights(lowered=lowered, share=share))
    inner = true > 1.6 * R
    before = np.abs(measured - true)[inner]
    after = np.abs(drawn_heights(measured) - true)[inner]
    # a pixel is 0.23 r wide, so half a pixel beside the axis changes the height at 0.8 r by 0.15 r; ends are not drawn
    assert np.median(after) < 0.06 * R
    assert np.percentile(after, 90) < 0.2 * R
    assert np.median(after) < 0.3 * np.median(before)


def test_the_table_stays() -> None:
    true = string_heights()
    heights = drawn_heights(in_windows(true))
    far = in_windows(true, 15) == 0
    assert np.abs(heights[far]).max() < 0.0001


def test_a_string_that_lies_on_another_keeps_its_height() -> None:
    """The upper string is 2 r above the table. Windows lowered it by as much as the one on the table."""
    lower = in_windows(string_heights())
    raised = np.where(lower > 0.2 * R, lower + 2 * R, 0.0)
    heights = drawn_heights(np.vstack([lower[40:160], raised[40:160]])[20:220])
    assert np.percentile(heights[:100], 99) == pytest.approx(2 * R, rel=0.03)
    assert np.percentile(heights[100:], 99) == pytest.approx(4 * R, rel=0.08)


def test_sharp_depth_is_not_drawn() -> None:
    view = aligned(string_heights())
    assert draw_into_views([view], is_matched=False) is None
    assert draw_into_views([view], is_matched=True) is not None


def test_views_without_bands_are_not_drawn() -> None:
    table = aligned(np.zeros_like(string_heights()))
    assert draw_into_views([table], is_matched=True) is None
    string = aligned(in_windows(string_heights()))
    assert draw_into_views([string, table], is_matched=True) is None


def test_an_empty_image_is_left_as_it_is() -> None:
    string = aligned(in_windows(string_heights()))
    empty = align_view(replace(view_of(string_heights()), depth=np.zeros_like(string.view.depth)), P, Scene())
    drawn = draw_into_views([string, empty], is_matched=True)
    assert drawn is not None
    assert drawn.images[1] is empty.view
    assert not np.array_equal(drawn.images[0].depth, string.view.depth)


def test_the_loss_before_drawing_is_kept() -> None:
    drawn = draw_into_views([aligned(in_windows(string_heights(lowered=0.3, share=0.7)))], is_matched=False)
    assert drawn is not None
    # The string lost 30 % in 70 % of its length, and a little more by the windows.
    assert drawn.lost_m == pytest.approx(0.3 * 2 * R, rel=0.25)
    assert drawn.compression == pytest.approx(0.68, abs=0.05)


def test_a_lower_object_beside_a_string_is_not_drawn() -> None:
    """A strip that is as wide as the string and 45 % as high stays low, and the string is not raised."""
    string = string_heights()
    strip = np.zeros_like(string)
    strip[170:178, 40:280] = 0.45 * 2 * R
    heights = drawn_heights(in_windows(string + strip))
    assert np.percentile(heights[:160][string[:160] > 1.9 * R], 95) < 2.1 * R
    assert heights[165:183].max() < 1.2 * R


@pytest.fixture(scope="module")
def matched() -> SimulatedScan:
    """Two views of a loop whose depth was matched in rendered images."""
    options = RenderingOptions(sheath="woven", table_top="printed")
    return simulate(make_scene("loop", 3, R, 0.4), camera_model("d435"), 3, views=2, rendering=options)


def test_a_single_matched_view_shows_the_whole_string(matched: SimulatedScan) -> None:
    scene = Scene(matched.header.table_z_m, matched.header.workspace_m)
    model = recognise(matched.views[:1], RecognitionRequest(radius_m=R), scene).model
    result = score(model.to_json(), matched.truth)
    assert result.topology
    assert result.cover > 0.95
    (note,) = (each for each in model.quality.findings if each.code == "stereo-depth-corrected")
    assert "strings were drawn as tubes along their bands" in note.message


def test_strings_are_drawn_only_while_one_viewpoint_shows_them(matched: SimulatedScan) -> None:
    scene = Scene(matched.header.table_z_m, matched.header.workspace_m)
    first = ingest_views(matched.views[:1], P, scene)
    assert first.drawn is not None
    assert first.is_matched
    both = ingest_views(matched.views, P, scene, first)
    assert both.drawn is None
    fresh = ingest_views(matched.views, P, scene)
    for continued, direct in zip(both.targets, fresh.targets, strict=True):
        np.testing.assert_array_equal(continued.points, direct.points)
    # A second image from the same position is drawn as well.
    again = replace(matched.views[0], index=1)
    same = ingest_views([matched.views[0], again], P, scene)
    assert same.drawn is not None
    assert len(same.drawn.images) == 2
