"""Views that show another scene are excluded, according to the majority of the views."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from calibration.geometry.transforms import from_rotation_vector
from cell.devices import View
from recognition.errors import ContradictingViewsError, DepthNoiseError
from recognition.model.quality import ExclusionReason
from recognition.parameters import ChainParameters
from recognition.preprocessing.normals import NormalCloud
from recognition.preprocessing.table_scatter import TableScatter
from recognition.registration import free_space_check
from recognition.registration.free_space_check import (
    MAX_FREE_SPACE_VIOLATION,
    MAX_ROBOT_SIGMA,
    find_inconsistent_views,
    free_space_violations,
)

K = np.array([[400.0, 0.0, 159.5], [0.0, 400.0, 99.5], [0.0, 0.0, 1.0]])
# Straight above the origin, 0.4 m high; the image's x axis is the base's.
T_BASE_CAMERA = from_rotation_vector((0.0, 0.0, 0.4), (np.pi, 0, 0))


def image(view: int, depth: np.ndarray) -> View:
    return View(view, depth, 1e-4, K, T_BASE_CAMERA, np.eye(4))


def strip(view: int, y_m: float, x_m: tuple[float, float] = (-0.1, 0.1)) -> NormalCloud:
    """Return the view of a flat strip along x from straight above, 8 mm wide and 8 mm above the table."""
    u, v = np.meshgrid(np.arange(320), np.arange(200))
    x, y = (u - K[0, 2]) / K[0, 0] * 0.392, -(v - K[1, 2]) / K[1, 1] * 0.392
    on = (np.abs(y - y_m) < 0.004) & (x > x_m[0]) & (x < x_m[1])
    depth = np.where(on, 3920, 4000).astype(np.uint16)
    points = np.column_stack([x[on], y[on], np.full(on.sum(), 0.008)])
    order = np.lexsort(points.T[::-1])
    normals = np.tile((0.0, 0.0, 1.0), (len(points), 1))
    return NormalCloud(view, points[order], normals, np.eye(4), T_BASE_CAMERA, image(view, depth))


def inconsistent(
    clouds: Sequence[NormalCloud], table_1: ChainParameters, robot: float = 1.0
) -> dict[int, ExclusionReason]:
    return find_inconsistent_views(clouds, np.full(len(clouds), robot), table_1)


def violations_of(
    clouds: Sequence[NormalCloud], table_1: ChainParameters, table_z_m: float | None = None
) -> np.ndarray:
    return free_space_violations(clouds, table_1, table_z_m)[0]


def test_views_of_one_scene_have_no_free_space_violations(table_1: ChainParameters) -> None:
    # Pose errors reach 1.5 mm, which is not another position.
    clouds = [strip(0, 0.0), strip(1, 0.0015), strip(2, -0.001)]
    np.testing.assert_array_equal(violations_of(clouds, table_1), 0.0)
    assert inconsistent(clouds, table_1) == {}


def test_a_strip_at_another_position_is_in_free_space(table_1: ChainParameters) -> None:
    violations = violations_of([strip(0, 0.0), strip(1, 0.02)], table_1)
    assert (np.diag(violations) == 0).all()
    assert min(violations[0, 1], violations[1, 0]) > 0.9


@pytest.mark.parametrize("count", [3, 4, 8])
def test_the_contradicting_view_is_excluded_in_any_position(table_1: ChainParameters, count: int) -> None:
    for wrong in (0, count - 1):
        clouds = [strip(10 + k, 0.02 if k == wrong else 0.0) for k in range(count)]
        reasons = inconsistent(clouds, table_1)
        assert list(reasons) == [10 + wrong]
        assert reasons[10 + wrong].code == "view-contradicting"
        assert "contradicts the other views" in reasons[10 + wrong].message


def test_two_of_five_views_can_be_wrong_in_different_ways(table_1: ChainParameters) -> None:
    places = [0.0, 0.02, 0.0, -0.03, 0.0]
    assert sorted(inconsistent([strip(k, y) for k, y in enumerate(places)], table_1)) == [1, 3]


def test_a_shift_along_a_straight_strip_shows_at_its_ends(table_1: ChainParameters) -> None:
    clouds = [strip(k, 0.0) for k in range(4)]
    clouds[2] = strip(2, 0.0, (-0.08, 0.12))
    assert list(inconsistent(clouds, table_1)) == [2]
    # Ends that differ by a few pixels are the same scene.
    clouds[2] = strip(2, 0.0, (-0.098, 0.103))
    assert inconsistent(clouds, table_1) == {}


@pytest.mark.parametrize("places", [(0.0, 0.02), (0.0, 0.0, 0.02, 0.02), (0.0, 0.02, 0.04)])
def test_without_a_majority_there_is_no_answer(table_1: ChainParameters, places: tuple[float, ...]) -> None:
    with pytest.raises(ContradictingViewsError, match=r"views [0-9] and [0-9] contradict each other") as caught:
        inconsistent([strip(k, y) for k, y in enumerate(places)], table_1)
    assert caught.value.slug == "contradicting-views"


def test_the_number_of_checked_points_is_linear_in_the_number_of_views(
    table_1: ChainParameters, monkeypatch: pytest.MonkeyPatch
) -> None:
    checked: list[int] = []
    check = free_space_check._check_points

    def counted(
        cloud: NormalCloud, points: np.ndarray, normals: np.ndarray, radius: float, min_z_m: float
    ) -> tuple[np.ndarray, np.ndarray]:
        checked.append(len(points))
        return check(cloud, points, normals, radius, min_z_m)

    monkeypatch.setattr(free_space_check, "_check_points", counted)
    cloud = strip(0, 0.0)
    total = {}
    for count in (8, 16, 32):
        checked.clear()
        free_space_violations([replace(cloud, view=k) for k in range(count)], table_1)
        total[count] = sum(checked)
    assert total[16] < 2.3 * total[8]
    assert total[32] < 2.3 * total[16]


def test_wrong_views_among_many_are_excluded(table_1: ChainParameters) -> None:
    # A shift of 20 mm along the strip, and two halves of the views that contradict each other.
    clouds = [strip(k, 0.0, (-0.08, 0.12) if k in (3, 20) else (-0.1, 0.1)) for k in range(32)]
    assert sorted(inconsistent(clouds, table_1)) == [3, 20]
    with pytest.raises(ContradictingViewsError):
        inconsistent([strip(k, 0.02 if k < 16 else 0.0) for k in range(32)], table_1)


def test_views_excluded_for_their_robot_error_count_against_the_majority(table_1: ChainParameters) -> None:
    # Two of five views contradict the others. One of the three that agree has a wrong robot pose.
    clouds = [strip(k, y) for k, y in enumerate([0.0, 0.02, 0.0, -0.03, 0.0])]
    robot = np.array([1.0, 1.0, 1.0, 1.0, MAX_ROBOT_SIGMA + 5])
    with pytest.raises(
        ContradictingViewsError, match=r"3 of 5 views would have to be excluded.*view 4: its pose"
    ) as caught:
        find_inconsistent_views(clouds, robot, table_1)
    assert "check the poses" in str(caught.value)


def test_a_view_does_not_contradict_surface_that_it_does_not_see(table_1: ChainParameters) -> None:
    whole, half = strip(0, 0.0), strip(1, 0.0)
    assert half.image is not None
    # Half of the second image is without depth.
    depth = half.image.depth.copy()
    depth[:, 160:] = 0
    kept = half.points[:, 0] < 0
    half = replace(half, points=half.points[kept], normals=half.normals[kept], image=image(1, depth))
    # An object hides part of the strip in the third.
    hidden = strip(2, 0.0)
    assert hidden.image is not None
    before = hidden.image.depth.copy()
    before[60:140, 200:260] = 3000
    hidden = replace(hidden, image=image(2, before))
    np.testing.assert_array_equal(violations_of([whole, half, hidden], table_1), 0.0)
    # Behind the camera, and outside its image.
    away = replace(strip(3, 0.0), points=strip(3, 0.0).points + np.array([0.0, 0.0, 1.0]))
    aside = replace(strip(4, 0.0), points=strip(4, 0.0).points + np.array([1.0, 0.0, 0.0]))
    np.testing.assert_array_equal(violations_of([whole, away, aside], table_1)[0], 0.0)


def test_without_images_nothing_is_contradicted(table_1: ChainParameters) -> None:
    clouds = [replace(strip(k, 0.02 * k), image=None) for k in range(3)]
    np.testing.assert_array_equal(violations_of(clouds, table_1), 0.0)
    assert inconsistent(clouds, table_1) == {}


def test_a_view_with_an_implausible_robot_error_is_excluded(table_1: ChainParameters) -> None:
    clouds = [strip(k, 0.0) for k in range(4)]
    robot = np.array([1.0, 2.0, MAX_ROBOT_SIGMA + 2, 1.5])
    reasons = find_inconsistent_views(clouds, robot, table_1)
    assert list(reasons) == [2]
    assert reasons[2].code == "view-pose-error"
    assert "12 sigma of the arm's accuracy (the other views: 2)" in reasons[2].message
    # If the arm is worse than assumed in all views, no single view is at fault. Of two views, either may be wrong.
    assert find_inconsistent_views(clouds, robot + 8, table_1) == {}
    assert find_inconsistent_views(clouds[1:3], robot[1:3], table_1) == {}


def with_noise(cloud: NormalCloud, scatter_m: float) -> NormalCloud:
    return replace(cloud, scatter=TableScatter(scatter_m, scatter_m))


def test_noise_is_the_reason_if_it_explains_the_contradictions(table_1: ChainParameters) -> None:
    """With a scatter of 1 mm, two depths differ by the radius of 4.2 mm in 3 sigma."""
    clouds = [strip(k, 0.02 * (k % 2)) for k in range(4)]
    with pytest.raises(DepthNoiseError, match=r"scatters by 1\.2 mm .*more than 1\.0 mm.*radius of 4\.2 mm") as caught:
        inconsistent([with_noise(cloud, 0.0012) for cloud in clouds], table_1)
    assert caught.value.slug == "depth-noise"
    with pytest.raises(ContradictingViewsError):
        inconsistent([with_noise(cloud, 0.0008) for cloud in clouds], table_1)


def test_a_depth_far_below_the_table_shows_no_free_space(table_1: ChainParameters) -> None:
    deep = strip(1, 0.0)
    assert deep.image is not None
    deep = replace(deep, image=image(1, np.where(deep.image.depth == 3920, 4200, 4000).astype(np.uint16)))
    clouds = [strip(0, 0.0), deep, strip(2, 0.0)]
    assert violations_of(clouds, table_1)[1, 0] > 0.5
    np.testing.assert_array_equal(violations_of(clouds, table_1, 0.0), 0.0)
    # The table itself shows free space.
    assert (
        violations_of([strip(0, 0.0), strip(1, 0.02)], table_1, 0.0).min(where=~np.eye(2, dtype=bool), initial=1) > 0.9
    )


def test_few_points_are_no_contradiction() -> None:
    """The same share of 5 % is a contradiction if it is measured on many points."""
    shares = np.full((4, 4), 0.05)
    np.fill_diagonal(shares, 0.0)
    few, many = (np.full((4, 4), n) - n * np.eye(4, dtype=np.int64) for n in (20, 600))
    assert free_space_check._view_scores(shares, few).max() < MAX_FREE_SPACE_VIOLATION
    assert free_space_check._view_scores(shares, many).min() > MAX_FREE_SPACE_VIOLATION


def test_pairs_of_views_with_few_points_have_little_weight() -> None:
    """Two of three pairs of a view share ten points, of which one is in free space. The third one agrees."""
    shares, counts = np.zeros((4, 4)), np.full((4, 4), 300)
    shares[:3, :3], counts[:3, :3] = 0.1, 10
    np.fill_diagonal(shares, 0.0)
    np.fill_diagonal(counts, 0)
    assert free_space_check._view_scores(shares, counts).max() < MAX_FREE_SPACE_VIOLATION
