"""Intensity images of bags: which are aligned with the depth, and which belong to a view."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from calibration.geometry.transforms import from_rotation_vector
from cell.bag.errors import BagError
from cell.devices import View
from tests.cell.bag.bags import CAMERA, KINDS, START_NS, TF_STATIC, Kind, Moment, Recorded, one_image_each
from tests.cell.bag.made import FINE, assert_same_views, imported, made_views

pytestmark = pytest.mark.slow

LEFT = "/camera/infra1/image_rect_raw"
LEFT_INFO = "/camera/infra1/camera_info"


@dataclass(frozen=True)
class Infrared:
    """How left images are recorded."""

    frame: str = CAMERA
    encoding: str = "mono8"
    size: tuple[int, int] = (12, 16)
    K_factor: float = 1.0
    late_ns: int = 0
    copies: int = 1
    with_info: bool = True
    static: Mapping[tuple[str, str], NDArray[np.float64]] = field(default_factory=dict)


def grey(index: int, size: tuple[int, int] = (12, 16)) -> NDArray[np.uint8]:
    return np.random.default_rng(index).integers(0, 200, size, dtype=np.uint8)


def moments(views: Sequence[View], how: Infrared) -> Iterator[Moment]:
    """Yield the messages of a scan with `copies` left images per view, whose grey levels rise by 2."""
    K = views[0].K.copy()
    K[:2] *= how.K_factor
    if how.static:
        yield Moment(TF_STATIC, START_NS, lambda ros: ros.tf(START_NS, how.static))
    if how.with_info:
        yield Moment(LEFT_INFO, START_NS, lambda ros: ros.info(START_NS, K, (how.size[1], how.size[0]), how.frame, {}))
    yield from one_image_each(views, Recorded())
    for k, view in enumerate(views):
        for copy in range(how.copies):
            at_ns = round(view.stamp_s * 1e9) + how.late_ns
            pixels: NDArray[Any] = grey(k, how.size) + np.uint8(2 * copy)
            yield Moment(LEFT, at_ns, lambda ros, t=at_ns, p=pixels: ros.image(t, p, how.encoding, how.frame, {}))


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("late_ns", [0, 8_000_000])
def test_left_images_of_the_camera_of_the_depth_are_imported(tmp_path: Path, kind: Kind, late_ns: int) -> None:
    views = made_views(3)
    contents, got = imported(tmp_path, moments(views, Infrared(late_ns=late_ns)), FINE, kind)
    assert_same_views(got, views)
    assert contents.intensity_topic == LEFT
    assert got.header.provenance["intensity_topic"] == LEFT
    for view in got.views:
        np.testing.assert_array_equal(view.intensity, grey(view.index))


def test_a_view_has_the_mean_of_its_left_images(tmp_path: Path) -> None:
    _, got = imported(tmp_path, moments(made_views(2), Infrared(copies=3)))
    for view in got.views:
        np.testing.assert_array_equal(view.intensity, grey(view.index) + np.uint8(2))


def test_left_images_that_were_taken_elsewhere_belong_to_no_view(tmp_path: Path) -> None:
    _, got = imported(tmp_path, moments(made_views(2), Infrared(late_ns=10**9)))
    assert [view.intensity for view in got.views] == [None, None]


def test_a_frame_at_the_same_place_is_that_of_the_depth(tmp_path: Path) -> None:
    how = Infrared(frame="infra1", static={(CAMERA, "infra1"): np.eye(4)})
    contents, _ = imported(tmp_path, moments(made_views(2), how))
    assert contents.intensity_topic == LEFT


MISFITS = [
    (Infrared(encoding="8UC3", size=(12, 16)), "its images are '8UC3', not mono8"),
    (Infrared(with_info=False), "there is no /camera/infra1/camera_info"),
    (Infrared(size=(24, 32)), "it is of 32x24 pixels, the depth of 16x12"),
    (Infrared(K_factor=1.1), "its camera matrix is another one"),
    (Infrared(frame="unknown"), "/tf does not contain the frame 'unknown'"),
    (
        Infrared(frame="infra2", static={(CAMERA, "infra2"): from_rotation_vector((0.05, 0, 0), (0, 0, 0))}),
        "its frame 'infra2' is 50.0 mm from 'camera_depth_optical_frame'",
    ),
]


@pytest.mark.parametrize(("how", "message"), MISFITS)
def test_other_images_are_left_out_unless_they_are_named(tmp_path: Path, how: Infrared, message: str) -> None:
    views = made_views(2)
    (tmp_path / "found").mkdir()
    contents, got = imported(tmp_path / "found", moments(views, how))
    assert contents.intensity_topic is None
    assert "intensity_topic" not in got.header.provenance
    assert [view.intensity for view in got.views] == [None, None]
    (tmp_path / "named").mkdir()
    with pytest.raises(BagError, match=f"infra1/image_rect_raw is not aligned .*{message}.*--intensity-topic"):
        imported(tmp_path / "named", moments(views, how), replace(FINE, intensity_topic=LEFT))


def test_an_unknown_topic_is_named(tmp_path: Path) -> None:
    with pytest.raises(BagError, match=f"no topic /left of other images than depth; .*may be: {LEFT}"):
        imported(tmp_path, moments(made_views(2), Infrared()), replace(FINE, intensity_topic="/left"))
