"""Views are extracted where the arm is at rest, and only there."""

from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

from calibration.geometry.transforms import from_rotation_vector, inverse
from cell.bag.errors import BagError
from cell.bag.import_bag import import_bag
from cell.devices import View
from tests.cell.bag.bags import (
    CAMERA,
    START_NS,
    Matrix,
    Moment,
    Recorded,
    write_bag,
)
from tests.cell.bag.made import FINE, T_FLANGE_CAMERA, assert_same_views, imported, made_views

T_BASE_LINK_BASE = from_rotation_vector((0, 0, 0.02), (0, 0, 2.9))
"""Approximate pose of the frame `base` of UR in `base_link` of ROS. An exact half turn would be its own inverse."""


T_WRIST_FLANGE = from_rotation_vector((0.0, 0.0, 0.1), (-1.5, 0.0, 0.2))


MOVE_S, REST_S, SHAKE_S = 0.8, 1.5, 0.5
"""Durations in the continuous bag: of a move, of a rest, and of the vibration at the start of a rest, seconds."""


def continuous(views: list[View], how: Recorded) -> Iterator[Moment]:
    """Yield the messages of a bag that was recorded without a pause: 30 poses and 15 images per second.

    While the arm moves or vibrates, the images show something else. One image of each rest has a hole.
    """
    yield from how.beginning(views[0])
    time_s, rng = 0.02, np.random.default_rng(3)
    waypoints = [views[-1].T_base_flange, *(view.T_base_flange for view in views)]
    step = 0
    for k, (before, after) in enumerate(pairwise(waypoints)):
        way = Slerp([0, 1], Rotation.from_matrix([before[:3, :3], after[:3, :3]]))
        began_s = time_s
        in_rest = 0
        while time_s < began_s + MOVE_S + REST_S:
            share = min((time_s - began_s) / MOVE_S, 1.0)
            T = np.eye(4)
            T[:3, :3] = way(share).as_matrix()
            T[:3, 3] = before[:3, 3] + share * (after[:3, 3] - before[:3, 3])
            yield how.pose(T, START_NS + round(time_s * 1e9))
            if step % 2:
                still = time_s > began_s + MOVE_S + SHAKE_S
                pixels = views[k].depth.copy() if still else rng.integers(1, 9000, (12, 16), dtype=np.uint16)
                in_rest += still
                if in_rest == 4:
                    pixels[:6] = 0
                seen = replace(views[k], depth=pixels)
                yield how.depth(how.pixels(seen), START_NS + round((time_s + 0.011) * 1e9))
            step += 1
            time_s += 1 / 30


def ur(T_base_flange: Matrix) -> dict[tuple[str, str], Matrix]:
    """Return the transforms of the driver of UR, simplified: base_link carries the arm and the rotated frame `base`."""
    return {("base_link", "wrist_3_link"): T_BASE_LINK_BASE @ T_base_flange @ inverse(T_WRIST_FLANGE)}


UR_STATIC = {
    ("world", "base_link"): from_rotation_vector((1.0, 2.0, 0.5), (0.0, 0.0, 0.3)),
    ("base_link", "base"): T_BASE_LINK_BASE,
    ("wrist_3_link", "flange"): from_rotation_vector((0.0, 0.0, 0.0), (0.0, -np.pi / 2, -np.pi / 2)),
    ("wrist_3_link", "tool0"): T_WRIST_FLANGE,
    ("tool0", "camera_link"): from_rotation_vector((0.01, 0.0, 0.02), (0.0, -1.5, 0.0)),
    ("camera_link", CAMERA): inverse(from_rotation_vector((0.01, 0.0, 0.02), (0.0, -1.5, 0.0))) @ T_FLANGE_CAMERA,
}


@pytest.mark.parametrize("encoding", ["16UC1", "32FC1"])
def test_a_continuous_bag_gives_one_view_per_rest(tmp_path: Path, encoding: str) -> None:
    views = made_views(8)
    how = Recorded(encoding, edges=ur, static=UR_STATIC)
    contents, got = imported(tmp_path, continuous(views, how))
    assert_same_views(got, views)
    assert not contents.stationary.single
    assert contents.stationary.moving >= 8 * 6
    assert (contents.frames.base, contents.frames.flange) == ("base", "tool0")
    assert got.header.provenance["frames_per_view"] == "5 5 5 5 5 5 5 5"


def test_a_pose_between_two_samples_is_interpolated(tmp_path: Path) -> None:
    """The arm creeps too slowly to count as motion. The pose is that at the stamp of the image."""
    view = made_views(2)
    how = Recorded()

    def moments() -> Iterator[Moment]:
        yield from how.beginning(view[0])
        for k in range(2):
            for tenth in range(-4, 5):
                T = from_rotation_vector((0.3 + 0.1 * k + 1e-4 * tenth, 0, 0.4), (3.0, 1e-4 * tenth, 0))
                yield how.pose(T, START_NS + (3 * k + 1) * 10**9 + tenth * 10**8)
            yield how.depth(view[k].depth, START_NS + (3 * k + 1) * 10**9 + 25_000_000)

    _, got = imported(tmp_path, moments())
    for k, seen in enumerate(got.views):
        assert seen.T_base_flange[0, 3] == pytest.approx(0.3 + 0.1 * k + 0.25e-4, abs=1e-9)
        half = from_rotation_vector((0, 0, 0), (3.0, 0.25e-4, 0))
        np.testing.assert_allclose(seen.T_base_flange[:3, :3], half[:3, :3], rtol=0, atol=1e-9)


def test_an_arm_that_never_rests_gives_no_view(tmp_path: Path) -> None:
    """The flange moves on a circle at 50 mm/s with poses at 30 Hz. No two neighbouring poses are a rest."""
    how, view = Recorded(), made_views(1)[0]

    def moments() -> Iterator[Moment]:
        yield from how.beginning(view)
        for k in range(120):
            at_ns = START_NS + k * 33_333_333
            yield how.pose(from_rotation_vector((0.05 * k / 30, 0, 0.4), (3.0, 0, 0)), at_ns)
            yield how.depth(view.depth, at_ns)

    bag = write_bag(tmp_path / "scan", "mcap", moments())
    with pytest.raises(BagError, match=r"stands still at 0 poses .of 120 depth images, 120 were taken in motion"):
        import_bag(bag, tmp_path / "out.mcap", FINE)


@pytest.mark.parametrize("away_s", [1, 60])
def test_images_during_a_gap_in_the_poses_give_no_view(tmp_path: Path, away_s: int) -> None:
    """The transforms are interrupted and continue with the same pose. The arm may have moved meanwhile."""
    views, how = made_views(2), Recorded()
    elsewhere = np.full((12, 16), 777, np.uint16)

    def moments() -> Iterator[Moment]:
        yield from how.beginning(views[0])
        for k, view in enumerate(views):
            begin = START_NS + k * 100 * 10**9
            for after in (0, away_s * 10**9):
                for tenth in range(6):
                    at_ns = begin + after + tenth * 10**8
                    yield how.pose(view.T_base_flange, at_ns)
                    yield how.depth(view.depth, at_ns)
            for share in np.linspace(0.4, 0.6, 20) if away_s > 1 else ():
                yield how.depth(elsewhere, begin + round(share * away_s * 1e9))

    _, got = imported(tmp_path, sorted(moments(), key=lambda moment: moment.stamp_ns))
    assert_same_views(got, views)


def test_sparse_poses_of_a_moving_arm_give_no_view(tmp_path: Path) -> None:
    """The bag has ten images and one pose per second of a moving arm. Images at the poses are not views."""
    how, view = Recorded(), made_views(1)[0]

    def moments() -> Iterator[Moment]:
        yield from how.beginning(view)
        for k in range(60):
            at_ns = START_NS + k * 10**8
            if k % 10 == 0:
                yield how.pose(from_rotation_vector((0.01 * k, 0, 0.4), (3.0, 0, 0)), at_ns)
            yield how.depth(view.depth, at_ns)

    bag = write_bag(tmp_path / "scan", "mcap", moments())
    with pytest.raises(BagError, match="stands still at 0 poses"):
        import_bag(bag, tmp_path / "out.mcap", FINE)
