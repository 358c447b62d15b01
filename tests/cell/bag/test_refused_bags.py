"""Bags that cannot be imported are refused with an action, and no file is left."""

import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cell.bag.errors import BagError
from cell.bag.import_bag import BagRequest, import_bag
from cell.recording import RecordingError, RecordingExistsError
from tests.cell.bag.bags import (
    CAMERA,
    DEPTH,
    INFO,
    KINDS,
    START_NS,
    TF,
    TF_STATIC,
    Kind,
    Matrix,
    Moment,
    Recorded,
    one_image_each,
    write_bag,
)
from tests.cell.bag.made import FINE, T_FLANGE_CAMERA, imported, made_views

pytestmark = pytest.mark.slow


def camera_that_hangs(T: Matrix) -> dict[tuple[str, str], Matrix]:
    """Return a camera that is fixed in the cell, so that it moves relative to the flange."""
    return {("base", "tool0"): T, ("base", CAMERA): T_FLANGE_CAMERA}


NOWHERE = np.zeros((4, 4))
NOWHERE[0, 3] = np.nan


@pytest.mark.parametrize(
    ("how", "bag_request", "said"),
    [
        (
            Recorded(),
            BagRequest(depth_topic="/nope"),
            r"no topic /nope of type Image; --depth-topic may be: /camera/depth/im",
        ),
        (
            Recorded(),
            BagRequest(info_topic=DEPTH),
            r"of type CameraInfo; --info-topic may be: /camera/depth/camera_info",
        ),
        (
            Recorded(),
            BagRequest(base_frame="ur_base"),
            r"no.* frame 'ur_base'; its frames: base, camera_depth.*, tool0",
        ),
        (
            Recorded(edges=lambda T: {("a", "b"): T}),
            BagRequest(),
            r"no frame base or base_link: name the base by --base-f",
        ),
        (
            Recorded(edges=lambda T: {("base", "b"): T}, static={}),
            BagRequest(),
            r"no frame tool0 or flange: name the flan",
        ),
        (
            Recorded(static={}),
            BagRequest(),
            r"pose of the camera on the flange is unknown: .*its frames: base, tool0; name a f",
        ),
        (
            Recorded(static={("mount", CAMERA): T_FLANGE_CAMERA}),
            BagRequest(),
            r"does not connect the frames 'tool0' and 'camera_.*first is below 'base', the second below 'mount'",
        ),
        (
            Recorded(edges=camera_that_hangs, static={}),
            BagRequest(),
            r"not fixed to 'tool0': it moves by up to 1\d+\.\d mm",
        ),
        (
            Recorded(edges=lambda T: {("base", "tool0"): T, ("world", "tool0"): T}),
            BagRequest(),
            r"several parents of the frame 'tool0': base, world; publish only",
        ),
        (Recorded(edges=lambda T: {("base", "tool0"): T, ("tool0", "base"): T}), BagRequest(), r"'\w+' below itself"),
        (
            Recorded(edges=lambda T: {("base", "tool0"): T + NOWHERE}),
            BagRequest(),
            r"'tool0' in 'base' holds nan; metres",
        ),
        (
            Recorded(image={"encoding": "8UC1"}),
            BagRequest(),
            r"no topic of depth images .*of other images: /camera/depth",
        ),
        (
            Recorded(image={"encoding": "rgb8"}),
            BagRequest(depth_topic=DEPTH),
            r"images are 'rgb8'; only 16UC1 and 32FC1",
        ),
        (Recorded(image={"step": 31}), BagRequest(), r"image of 16x12 pixels with 31 bytes a row has 384 bytes"),
        (Recorded(image={"width": 8}), BagRequest(), r"camera_info is of 16x12 pixels, the images .* are 8x12"),
        (Recorded(image={"width": 1 << 31, "height": 12}), BagRequest(), r"camera_info is of 16x12 pixels, the images"),
        (
            Recorded(info={"D": np.full(5, 0.1)}),
            BagRequest(depth_topic="/camera/depth/image"),
            r"no topic /camera/depth/im",
        ),
        (
            Recorded(info={"D": np.full(5, 0.1), "R": np.full(9, 0.1)}),
            BagRequest(),
            r"rectification turned or shifted the camera",
        ),
        (
            Recorded(info={"D": np.full(5, 0.1), "P": np.zeros(12)}),
            BagRequest(),
            r"are rectified, but their camera matrix P is 0",
        ),
        (
            # Without distortion too: the rectified images of a stereo pair.
            Recorded(info={"P": np.array([20.0, 0, 7.5, -1.5, 0, 21, 5.5, 0, 0, 0, 1, 0])}),
            BagRequest(),
            r"rectification turned or shifted the camera",
        ),
        (
            Recorded(info={"K": np.zeros(9), "P": np.zeros(12)}),
            BagRequest(),
            r"view 0: K has focal lengths 0, 0; not a camera's",
        ),
        (Recorded(), BagRequest(depth_unit_m=1.0), r"depth_unit_m is 1; it must be from 1e-6 to 0.01 metres per count"),
        (Recorded(), BagRequest(workspace_m=((1, 0), (0, 1), (0, 1))), r"workspace_m is .* with x0 < x1"),
    ],
)
def test_each_unusable_content_is_refused_with_its_reason(
    tmp_path: Path, how: Recorded, bag_request: BagRequest, said: str
) -> None:
    bag = write_bag(tmp_path / "scan", "mcap", one_image_each(made_views(3), how))
    with pytest.raises(RecordingError, match=said):
        import_bag(bag, tmp_path / "out.mcap", bag_request)
    assert [path.name for path in tmp_path.iterdir()] == ["scan"], "no file is left"


def without(topic: str) -> list[Moment]:
    return [moment for moment in one_image_each(made_views(3), Recorded()) if moment.topic != topic]


def renamed(topic: str, new: str) -> list[Moment]:
    return [
        replace(moment, topic=new if moment.topic == topic else moment.topic)
        for moment in one_image_each(made_views(3), Recorded(info={"D": np.full(5, 0.1)}))
    ]


def shifted(seconds: float) -> list[Moment]:
    """Shift the stamps of the images, as with another clock."""
    how, views = Recorded(), made_views(3)
    moments = [how.depth(v.depth, round((v.stamp_s + seconds) * 1e9)) for v in views]
    return [*(m for m in one_image_each(views, how) if m.topic != DEPTH), *moments]


def compressed() -> list[Moment]:
    def make(ros: Any) -> Any:
        header, data = ros.header(START_NS, CAMERA), np.zeros(4, np.uint8)
        return ros.new("sensor_msgs/msg/CompressedImage", header=header, format="16UC1; compressedDepth png", data=data)

    return [*without(DEPTH), Moment(f"{DEPTH}/compressedDepth", START_NS, make)]


def with_nominal_camera_pose(topic: str) -> list[Moment]:
    """Add the nominal pose of the camera, 20 mm from the calibrated one."""
    nominal = T_FLANGE_CAMERA.copy()
    nominal[0, 3] += 0.02
    more = Moment(topic, START_NS, lambda ros: ros.tf(START_NS, {("tool0", CAMERA): nominal}))
    return [more, *without("")]


def infrared() -> list[Moment]:
    """Add infrared images to compressed depth."""
    grey = np.zeros((12, 16), np.uint16)
    image = Moment("/infra/image_rect", START_NS, lambda ros: ros.image(START_NS, grey, "mono16", CAMERA, {}))
    return [*compressed(), image]


def another_lens() -> list[Moment]:
    view = made_views(1)[0]
    return [*without(""), Recorded().intrinsics(replace(view, K=view.K * [[2], [2], [1]]), START_NS + 10**9)]


@pytest.mark.parametrize(
    ("moments", "said"),
    [
        (without(TF)[:1], r"no topic of depth images"),
        ([m for m in without(TF) if m.topic in (DEPTH, INFO)], r"no transforms \(/tf\): .*; its topics: /camera"),
        (without(INFO), r"not clear which CameraInfo belongs to .*--info-topic: none"),
        (renamed(DEPTH, "/camera/depth/image"), r"lens has distortion \(0.1, .*give --rectified if they are"),
        (
            [*without(""), *renamed(DEPTH, "/b/image_rect")],
            r"2 topics of depth images; name one.*: /b/image_rect, /cam",
        ),
        (
            shifted(3600.0),
            r"any of the 3 depth images: its stamps differ from those of the images by 3594\.0 s; synchronise",
        ),
        (
            with_nominal_camera_pose(TF),
            r"'camera_.*' in 'tool0', which /tf_static has as fixed, is given with several values, 20.0 mm",
        ),
        (
            with_nominal_camera_pose(TF_STATIC),
            r"given with several values, 20.0 mm and 0.00 degrees apart: record the bag without",
        ),
        (infrared(), r"depth images are compressed"),
        (compressed(), r"depth images are compressed \(.*compressedDepth\), which is not supported: .*republish"),
        (another_lens(), r"camera_info: the lens changes within the bag"),
        (list(one_image_each(made_views(65), Recorded())), r"stands still at 65 poses .*; at most 64 are read"),
    ],
)
def test_incomplete_bags_are_refused(tmp_path: Path, moments: list[Moment], said: str) -> None:
    bag = write_bag(tmp_path / "scan.bag", "ros1", moments)
    with pytest.raises(BagError, match=said):
        import_bag(bag, tmp_path / "out.mcap", FINE)
    assert [path.name for path in tmp_path.iterdir()] == ["scan.bag"], "no file is left"


@pytest.mark.parametrize("kind", KINDS)
def test_a_bag_cut_anywhere_is_refused_or_read(tmp_path: Path, kind: Kind) -> None:
    """Every exception of rosbags becomes an error with a message."""
    bag = write_bag(
        tmp_path / ("scan.bag" if kind == "ros1" else "scan"), kind, one_image_each(made_views(3), Recorded())
    )
    file = bag if bag.is_file() else next(path for path in bag.iterdir() if path.suffix != ".yaml")
    whole = file.read_bytes()
    rng = np.random.default_rng(11)
    refused = 0
    for k, length in enumerate(rng.integers(0, len(whole), 40)):
        damaged = bytearray(whole[:length] if k % 2 else whole)
        if k % 2 == 0:
            damaged[length : length + 40] = rng.bytes(min(40, len(whole) - length))
        file.write_bytes(damaged)
        out = tmp_path / f"{k}.mcap"
        try:
            import_bag(bag, out, FINE)
        except RecordingError:
            refused += 1
            assert not out.exists()
    assert refused >= 20
    assert not list(tmp_path.glob(".*"))


def test_files_that_are_not_bags_are_refused(tmp_path: Path) -> None:
    (tmp_path / "text.bag").write_text("hello")
    (tmp_path / "a.txt").write_text("hello")
    (tmp_path / "empty").mkdir()
    (tmp_path / "folder.bag").mkdir()
    for name, said in [
        ("none.bag", "there is no"),
        ("text.bag", "cannot be read as a bag: File magic is invalid"),
        ("a.txt", "is not a bag"),
        ("folder.bag", "is a folder, but its name ends like that of a ROS 1 bag"),
        ("empty", "no metadata.yaml and 0 files"),
    ]:
        with pytest.raises(BagError, match=said):
            import_bag(tmp_path / name, tmp_path / "out.mcap", FINE)


def test_a_recording_is_refused(tmp_path: Path) -> None:
    imported(tmp_path, one_image_each(made_views(2), Recorded()))
    with pytest.raises(BagError, match="Profile is not ros2"):
        import_bag(tmp_path / "scan.mcap", tmp_path / "out.mcap", FINE)


def test_nothing_is_overwritten(tmp_path: Path) -> None:
    (tmp_path / "out.mcap").write_text("mine")
    with pytest.raises(RecordingExistsError):
        import_bag(tmp_path / "none.bag", tmp_path / "out.mcap", FINE)
    assert (tmp_path / "out.mcap").read_text() == "mine"


def test_a_missing_package_is_reported_with_the_command_to_install_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "rosbags.highlevel", None)
    with pytest.raises(BagError, match=r"needs the extra `bag`: install .*'WHEEL\[bag\]'"):
        import_bag(tmp_path / "scan.bag", tmp_path / "out.mcap", FINE)
