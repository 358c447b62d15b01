import numpy as np
import pytest

from cell.simulation.scenes.planar_crossings import at, is_closed, near_pairs, plan_crossings

CROSS = (
    np.column_stack([np.linspace(-0.1, 0.1, 41), np.zeros(41)]),
    np.column_stack([np.linspace(-0.05, 0.05, 38), np.linspace(-0.05, 0.05, 38) * np.sqrt(3)]),
)


def test_two_lines_cross_once_at_their_intersection() -> None:
    (crossing,) = plan_crossings(CROSS)
    assert crossing.point == pytest.approx((0.0, 0.0), abs=1e-12)
    assert crossing.angle_rad == pytest.approx(np.pi / 3)
    assert (crossing.first[0], crossing.second[0]) == (0, 1)
    assert crossing.first[1] == pytest.approx(20.0)
    assert crossing.second[1] == pytest.approx(18.5)


def test_at_interpolates_between_two_points() -> None:
    assert at(CROSS[0], 20.5) == pytest.approx((0.0025, 0.0))
    assert at(CROSS[0], 40.0) == pytest.approx((0.1, 0.0))


def test_a_straight_line_does_not_cross_itself() -> None:
    assert plan_crossings(CROSS[:1]) == ()


def test_a_string_crosses_itself() -> None:
    t = np.linspace(0.3, 2 * np.pi - 0.3, 300)
    eight = np.column_stack([np.cos(t), np.sin(t) * np.cos(t)]) * 0.06
    (crossing,) = plan_crossings([eight])
    assert crossing.point == pytest.approx((0.0, 0.0), abs=1e-6)
    # A lemniscate of Gerono crosses itself at a right angle; the polyline follows it within half a degree.
    assert crossing.angle_rad == pytest.approx(np.pi / 2, abs=0.01)


def test_heights_do_not_matter() -> None:
    lifted = [np.column_stack([curve, np.full(len(curve), 0.01 * k)]) for k, curve in enumerate(CROSS)]
    assert len(plan_crossings(lifted)) == 1


def test_the_search_can_be_limited_to_new_points() -> None:
    x = np.linspace(-0.1, 0.1, 41)
    zigzag = np.column_stack([x, 0.01 * np.sin(60 * x + 0.3)])
    everything = plan_crossings([CROSS[0], zigzag])
    assert len(everything) == 4
    since = int(everything[2].second[1])
    known = plan_crossings([CROSS[0], zigzag[: since + 1]])
    assert known + plan_crossings([CROSS[0], zigzag], since + 1) == everything
    assert plan_crossings([]) == ()


def test_a_ring_does_not_cross_itself_where_it_closes() -> None:
    t = np.linspace(0.0, 2 * np.pi, 100)
    ring = np.column_stack([np.cos(t), np.sin(t)])
    assert not is_closed(ring)
    ring[-1] = ring[0]
    assert is_closed(ring)
    assert plan_crossings([ring]) == ()


def test_near_pairs_of_new_points_are_all_pairs_with_a_new_point() -> None:
    points = np.random.default_rng(0).uniform(0, 1, (200, 2))
    apart = np.linalg.norm(points[:, None] - points[None], axis=2)
    wanted = {(i, j) for j in range(170, 200) for i in range(j) if apart[i, j] <= 0.1}
    i, j = near_pairs(points, 0.1, 170)
    assert set(zip(i.tolist(), j.tolist(), strict=True)) == wanted
    assert len(wanted) > 50
