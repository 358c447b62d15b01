"""Lines extended or cut to where the depth images show the end of the string."""

from collections.abc import Callable

import numpy as np
import pytest
from scipy.spatial import KDTree

from cell.planning.look_at import look_at
from cell.simulation.evaluation.metrics import score
from cell.simulation.offline_scan import simulate
from cell.simulation.rendering.depth_camera import DepthCamera, camera_model
from cell.simulation.scenes.scenes import StringScene, make_scene
from recognition.pipeline import recognise
from recognition.preprocessing import Scene
from recognition.preprocessing.normals import NormalCloud
from recognition.refinement.end_in_images import localise_end_in_images, other_strand_tree
from recognition.request import RecognitionRequest
from tests.recognition.captured_strings import Image

R = 0.0042
STEP = 0.7 * R
DISTANCE_M = 0.6


def straight(start: tuple[float, float], end: tuple[float, float], z: float = R) -> np.ndarray:
    return np.column_stack([np.linspace(start, end, 101), np.full(101, z)])


def views(curves: list[np.ndarray], model: str = "exact") -> list[NormalCloud]:
    """Capture four steep views from as far as the camera sees strings."""
    camera = DepthCamera(camera_model(model), StringScene("hand-made", R, tuple(curves)))
    clouds = []
    for k in range(4):
        T = look_at(np.zeros(3), np.radians(45 + 90 * k), np.radians(70), DISTANCE_M, 0.0)
        depth = camera.capture(T, np.random.default_rng(k))
        image = Image(depth, camera.model.depth_unit_m, camera.model.K, T, k)
        clouds.append(NormalCloud(k, np.empty((0, 3)), np.empty((0, 3)), np.eye(4), T, image))
    return clouds


def line_from(x: float, to: float = 0.1) -> np.ndarray:
    points = np.arange(x, to, STEP)
    return np.column_stack([points, np.zeros_like(points), np.full_like(points, R)])


@pytest.mark.parametrize("model", ["exact", "ideal"])
@pytest.mark.parametrize("start", [-1.2, -0.5, 0.0, 0.5, 1.2])
def test_a_line_ends_within_half_a_pixel_of_the_string(model: str, start: float) -> None:
    seen = views([straight((0, 0), (0.1, 0))], model)
    ended = localise_end_in_images(line_from(start * R), seen, None, R)
    # A pixel is 1.5 mm wide at this distance. Edges of the noisy camera are displaced by a pixel (one sigma).
    assert ended[0, 0] == pytest.approx(0.0, abs=0.0008)
    np.testing.assert_allclose(ended[:, 1:], line_from(0)[: len(ended), 1:], atol=1e-9)
    np.testing.assert_array_equal(ended[-10:], line_from(start * R)[-10:])


def test_the_line_stays_where_no_image_shows_free_space_beyond_it() -> None:
    # The string continues beyond both ends of the window.
    seen = views([straight((-0.1, 0), (0.1, 0))])
    np.testing.assert_array_equal(localise_end_in_images(line_from(0), seen, None, R), line_from(0))


def test_the_line_stays_where_nothing_was_measured() -> None:
    seen = views([straight((0, 0), (0.1, 0))])
    for cloud in seen:
        assert cloud.image is not None
        cloud.image.depth[:] = 0
    np.testing.assert_array_equal(localise_end_in_images(line_from(0), seen, None, R), line_from(0))
    np.testing.assert_array_equal(localise_end_in_images(line_from(0), [], None, R), line_from(0))


def test_the_line_stays_where_the_camera_is_behind_the_end() -> None:
    (cloud, *_) = views([straight((0, 0), (0.1, 0))])
    assert cloud.T_base_camera is not None
    T = cloud.T_base_camera.copy()
    T[:3, 3] = -T[:3, 3]
    behind = NormalCloud(0, cloud.points, cloud.normals, cloud.T_correction, T, cloud.image)
    np.testing.assert_array_equal(localise_end_in_images(line_from(0), [behind], None, R), line_from(0))


def test_another_strand_across_the_end_does_not_extend_it() -> None:
    across = straight((-2.2 * R, -0.05), (-2.2 * R, 0.05))
    seen = views([straight((0, 0), (0.1, 0)), across])
    others = other_strand_tree([line_from(0), across], 0, R)
    for start in (-0.3, 0.3):
        ended = localise_end_in_images(line_from(start * R), seen, others, R)
        assert ended[0, 0] == pytest.approx(0.0, abs=0.0015)


def test_an_end_that_lies_on_another_strand_stays() -> None:
    under = straight((0, -0.05), (0, 0.05))
    seen = views([straight((0, 0), (0.1, 0), 3 * R), under])
    raised = line_from(0.6 * R) + (0, 0, 2 * R)
    others = other_strand_tree([raised, under], 0, R)
    np.testing.assert_array_equal(localise_end_in_images(raised, seen, others, R), raised)


def test_an_end_on_another_strand_makes_no_crossing() -> None:
    # The end would be extended beyond the middle of the other strand if the free space there were not checked.
    scan = simulate(make_scene("end-on-strand", 15), camera_model("ideal"), 15)
    model = recognise(
        scan.views, RecognitionRequest(radius_m=scan.truth["radius"]), Scene(workspace_m=scan.header.workspace_m)
    ).model
    assert len(model.chains) == 2
    assert model.crossings == ()
    assert score(model.to_json(), scan.truth).topology


def test_a_strand_above_hides_the_end() -> None:
    # The hidden part is neither string nor free space, so the line keeps its end.
    over = straight((-0.5 * R, -0.05), (-0.5 * R, 0.05), 3 * R)
    seen = views([straight((-0.05, 0), (0.1, 0)), over])
    others = other_strand_tree([line_from(R), over], 0, R)
    np.testing.assert_array_equal(localise_end_in_images(line_from(R), seen, others, R), line_from(R))


def test_the_line_away_from_the_end_counts_as_another_strand(arc: Callable) -> None:
    line = arc(0.03, 0, 300)
    tree = other_strand_tree([line], 0, R)
    assert isinstance(tree, KDTree)
    # Six radii from the first point.
    assert np.linalg.norm(tree.data - line[0], axis=1).min() > 5.9 * R
    assert other_strand_tree([line_from(0, 0.01)], 0, R) is None


@pytest.mark.parametrize("seen_from", [0.0, 90.0, 180.0])
def test_the_end_face_does_not_extend_the_line(seen_from: float) -> None:
    # A low camera sees the end face (180 degrees), only the side (90), or only the other side of the end (0).
    camera = DepthCamera(camera_model("exact"), StringScene("hand-made", R, (straight((0, 0), (0.1, 0)),)))
    T = look_at(np.zeros(3), np.radians(seen_from), np.radians(50), 0.4, 0.0)
    image = Image(camera.capture(T, np.random.default_rng(0)), camera.model.depth_unit_m, camera.model.K, T, 0)
    cloud = NormalCloud(0, np.empty((0, 3)), np.empty((0, 3)), np.eye(4), T, image)
    assert localise_end_in_images(line_from(0.5 * R), [cloud], None, R)[0, 0] == pytest.approx(0.0, abs=0.001)


def test_the_border_offset_moves_the_end_inwards() -> None:
    seen = views([straight((0, 0), (0.1, 0))])
    as_shown = localise_end_in_images(line_from(0), seen, None, R)
    moved = localise_end_in_images(line_from(0), seen, None, R, border_offset_m=0.3 * R)
    assert moved[0, 0] == pytest.approx(as_shown[0, 0] + 0.3 * R, abs=1e-9)
