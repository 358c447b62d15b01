"""Import of bags of scans with known truth."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calibration.geometry.transforms import from_rotation_vector
from cell.bag.import_bag import BagRequest, import_bag
from cell.recording import read_recording
from tests.cell.bag.bags import (
    CAMERA,
    DEPTH,
    INFO,
    KINDS,
    START_NS,
    TF_STATIC,
    Kind,
    Matrix,
    Moment,
    Recorded,
    one_image_each,
    write_bag,
)
from tests.cell.bag.made import FINE, assert_same_views, imported, made_views

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("encoding", ["16UC1", "32FC1"])
def test_a_bag_with_one_image_per_pose_gives_its_views(tmp_path: Path, kind: Kind, encoding: str) -> None:
    views = made_views(4)
    contents, got = imported(tmp_path, one_image_each(views, Recorded(encoding)), FINE, kind)
    assert_same_views(got, views)
    assert [view.stamp_s for view in got.views] == [view.stamp_s for view in views]
    assert got.header.depth_unit_m == 1e-4
    assert contents.stationary.single
    assert got.header.provenance == {
        "source": f"ROS {1 if kind == 'ros1' else 2} bag",
        "bag": "scan.bag" if kind == "ros1" else "scan",
        "depth_topic": DEPTH,
        "depth_encoding": encoding,
        "info_topic": INFO,
        "base_frame": "base",
        "flange_frame": "tool0",
        "camera_frame": CAMERA,
        "hand_eye": "tf",
        "frames_per_view": "1 1 1 1",
    }


def test_depth_counts_are_millimetres_by_default(tmp_path: Path) -> None:
    _, got = imported(
        tmp_path, one_image_each(made_views(2), Recorded()), BagRequest(string_radius_m=0.004, table_z_m=-0.1)
    )
    assert (got.header.depth_unit_m, got.header.string_radius_m, got.header.table_z_m) == (1e-3, 0.004, -0.1)


def test_invalid_depths_in_metres_become_zero(tmp_path: Path) -> None:
    views = made_views(2)
    metres = np.full((12, 16), 0.5, np.float32)
    metres[0, :8] = [np.nan, np.inf, -np.inf, 0.0, -0.3, 1e30, 0.00004, 7.0]  # the last value exceeds 16 bits

    def moments() -> Iterator[Moment]:
        how = Recorded("32FC1")
        for moment in one_image_each(views, how):
            yield moment if moment.topic != DEPTH else how.depth(metres, moment.stamp_ns)

    _, got = imported(tmp_path, moments())
    assert got.header.depth_unit_m == 1e-4
    assert not got.views[0].depth[0, :8].any()
    assert (got.views[0].depth.ravel()[8:] == 5000).all()


def test_big_endian_and_padded_rows_are_read(tmp_path: Path) -> None:
    views = made_views(2)
    padded = [np.pad(view.depth, ((0, 0), (0, 3)), constant_values=777).astype(">u2") for view in views]

    def moments() -> Iterator[Moment]:
        how = Recorded(image={"width": 16})
        images = iter(padded)
        for moment in one_image_each(views, how):
            yield moment if moment.topic != DEPTH else how.depth(next(images), moment.stamp_ns)

    _, got = imported(tmp_path, moments())
    assert_same_views(got, views)


def test_a_given_hand_eye_precedes_tf(tmp_path: Path) -> None:
    views = made_views(2)
    contents = from_rotation_vector((0.0, 0.1, 0.0), (0.0, 0.0, 1.0))
    request = replace(FINE, T_flange_camera=contents, hand_eye="mine.json abc")
    _, got = imported(tmp_path, one_image_each(views, Recorded(static={})), request)
    np.testing.assert_array_equal(got.header.T_flange_camera, contents)
    assert got.header.provenance["hand_eye"] == "mine.json abc"


def test_a_rectified_lens_is_taken_from_p(tmp_path: Path) -> None:
    P = np.array([[25.0, 0, 8, 0], [0, 26.0, 6, 0], [0, 0, 1, 0]])
    how = Recorded(info={"D": np.array([0.1, -0.2, 0, 0, 0]), "P": P.ravel()})
    _, got = imported(tmp_path, one_image_each(made_views(2), how))
    np.testing.assert_array_equal(got.views[0].K, P[:, :3])


def test_equal_static_poses_are_one_and_a_file_precedes_different_ones(tmp_path: Path) -> None:
    views = made_views(2)
    again, off = views[0].T_flange_camera.copy(), views[0].T_flange_camera.copy()
    again[0, 3] += 5e-5  # as rounded by another publisher
    off[0, 3] += 0.02

    def moments(T: Matrix) -> Iterator[Moment]:
        yield Moment(TF_STATIC, START_NS, lambda ros: ros.tf(START_NS, {("tool0", CAMERA): T}))
        yield from one_image_each(views, Recorded())

    for name, T, request in (("a", again, FINE), ("b", off, replace(FINE, T_flange_camera=views[0].T_flange_camera))):
        (tmp_path / name).mkdir()
        _, got = imported(tmp_path / name, moments(T), request)
        assert_same_views(got, views)


def test_an_image_topic_that_is_named_is_used_as_depth(tmp_path: Path) -> None:
    how = Recorded("mono16")
    _, got = imported(tmp_path, one_image_each(made_views(2), how), replace(FINE, depth_topic=DEPTH))
    assert_same_views(got, made_views(2))


def test_the_camera_info_beside_the_images_is_used(tmp_path: Path) -> None:
    views = made_views(2)

    def moments() -> Iterator[Moment]:
        yield Moment(
            "/other/camera_info", START_NS, lambda ros: ros.info(START_NS, 2 * views[0].K, (16, 12), "other", {})
        )
        colour = np.zeros((12, 16), np.uint8)
        yield Moment("/other/image", START_NS, lambda ros: ros.image(START_NS, colour, "mono8", "other", {}))
        yield from one_image_each(views, Recorded())

    contents, got = imported(tmp_path, moments())
    assert (contents.topics.depth, contents.topics.info) == (DEPTH, INFO)
    assert_same_views(got, views)


def test_the_file_of_a_folder_without_metadata_is_read(tmp_path: Path) -> None:
    views = made_views(2)
    bag = write_bag(tmp_path / "scan", "sqlite3", one_image_each(views, Recorded()))
    (bag / "metadata.yaml").unlink()
    import_bag(bag, tmp_path / "a.mcap", FINE)
    import_bag(bag / "scan.db3", tmp_path / "b.mcap", FINE)
    for name in ("a.mcap", "b.mcap"):
        assert_same_views(read_recording(tmp_path / name), views)
