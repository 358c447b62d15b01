"""The cache of rendered images: what it returns, its size, damaged files, and what the hash contains."""

import logging
import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cell.config.rendering_options import RenderingOptions
from cell.simulation.rendering.depth_camera import DepthCamera, ImageContent, camera_model
from cell.simulation.rendering.image_cache import ImageCache, cache_folder, image_key
from cell.simulation.rendering.stereo_camera import StillPair
from cell.simulation.scenes.scenes import make_scene

SHAPE = (3, 4)
FILE_BYTES = 600
"""More than the size of a file with two images of `SHAPE`."""
TINY = camera_model("oak-d-pro", (64, 40))
T = np.array([[1.0, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, 0.45], [0, 0, 0, 1]])


def pair(level: float) -> StillPair:
    image = np.full(SHAPE, level, dtype=np.float32)
    return StillPair(image, image + 1)


def fail() -> StillPair:
    raise AssertionError("the images are in the cache")


def test_images_are_rendered_once(tmp_path: Path) -> None:
    ImageCache(10**6, tmp_path / "made").get("a", SHAPE, lambda: pair(7.5))
    again = ImageCache(10**6, tmp_path / "made").get("a", SHAPE, fail)
    np.testing.assert_array_equal(again.left, pair(7.5).left)
    np.testing.assert_array_equal(again.right, pair(7.5).right)
    assert ImageCache(10**6, tmp_path / "made").get("b", SHAPE, lambda: pair(3)).left[0, 0] == 3


def cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:300])


def flip(path: Path) -> None:
    content = bytearray(path.read_bytes())
    content[200] ^= 0xFF
    path.write_bytes(content)


def empty(path: Path) -> None:
    path.write_bytes(b"")


def resize(path: Path) -> None:
    np.savez(path, left=np.zeros((2, 2), np.float32), right=np.zeros((2, 2), np.float32))


@pytest.mark.parametrize("damage", [cut, flip, empty, resize])
def test_damaged_files_are_rendered_again(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, damage: Callable[[Path], None]
) -> None:
    cache = ImageCache(10**6, tmp_path)
    cache.get("a", SHAPE, lambda: pair(1))
    damage(tmp_path / "a.npz")
    with caplog.at_level(logging.WARNING):
        assert cache.get("a", SHAPE, lambda: pair(2)).left[0, 0] == 2
    assert "a.npz is damaged, so its images are rendered again" in caplog.text
    assert cache.get("a", SHAPE, fail).left[0, 0] == 2


def test_the_files_that_were_not_used_for_the_longest_time_are_removed(tmp_path: Path) -> None:
    cache = ImageCache(4 * FILE_BYTES, tmp_path)
    for age, key in enumerate("dcba"):
        cache.get(key, SHAPE, lambda: pair(1))
        os.utime(tmp_path / f"{key}.npz", (1e9 - age, 1e9 - age))
    cache.get("a", SHAPE, fail)  # the oldest file becomes the newest
    (tmp_path / "x.partial").write_bytes(b"unfinished")
    os.utime(tmp_path / "x.partial", (1e9, 1e9))
    for key in "ef":
        cache.get(key, SHAPE, lambda: pair(1))
    left = {path.name for path in tmp_path.iterdir()}
    assert "x.partial" not in left
    assert {"a.npz", "f.npz"} <= left
    assert "b.npz" not in left
    assert sum(path.stat().st_size for path in tmp_path.iterdir()) <= 4 * FILE_BYTES


def test_a_size_of_zero_keeps_nothing(tmp_path: Path) -> None:
    cache = ImageCache(0, tmp_path / "made")
    assert cache.get("a", SHAPE, lambda: pair(1)).left[0, 0] == 1
    assert not (tmp_path / "made").exists()


def test_a_folder_that_cannot_be_written_is_reported_once(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    (tmp_path / "file").write_text("not a folder")
    cache = ImageCache(10**6, tmp_path / "file")
    for level in (1, 2):
        assert cache.get("a", SHAPE, lambda level=level: pair(level)).left[0, 0] == level
    assert caplog.text.count("rendered images are not kept") == 1


def test_the_folder_is_in_the_users_cache(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert tmp_path in cache_folder().parents or os.name == "nt"


def test_keys_differ_by_each_part() -> None:
    parts = (np.zeros((2, 2)), "a", 1.0, None)
    others = [
        (np.zeros((4, 1)), "a", 1.0, None),
        (np.zeros((2, 2)), "b", 1.0, None),
        (np.zeros((2, 2)), "a", 1.5, None),
    ]
    keys = {image_key(*some) for some in (parts, *others)}
    assert len(keys) == 4
    assert image_key(*parts) == image_key(*parts)


def test_the_cache_changes_no_depth(tmp_path: Path) -> None:
    scene = make_scene("loop", 1)
    depths = []
    for cache in (None, ImageCache(10**7, tmp_path), ImageCache(10**7, tmp_path)):
        camera = DepthCamera(TINY, scene, device_seed=1, cache=cache)
        depths.append(camera.capture(T, np.random.default_rng(0)))
    assert len(list(tmp_path.iterdir())) == 1
    np.testing.assert_array_equal(depths[1], depths[0])
    np.testing.assert_array_equal(depths[2], depths[0])


def test_whatever_changes_the_images_has_its_own_file(tmp_path: Path) -> None:
    scene = make_scene("loop", 1)
    bent = replace(scene, curves=(scene.curves[0] + [0.0, 0.001, 0.0],))
    dots = ImageContent(RenderingOptions(ir_dots=0.5))
    rng = np.random.default_rng(0)
    cache = ImageCache(10**7, tmp_path)
    cameras = [
        DepthCamera(TINY, scene, 0.0, 1, cache=cache),
        DepthCamera(TINY, bent, 0.0, 1, cache=cache),
        DepthCamera(TINY, scene, 0.1, 1, cache=cache),
        DepthCamera(TINY, scene, 0.0, 2, cache=cache),
        DepthCamera(TINY, scene, 0.0, 1, dots, cache),
        DepthCamera(camera_model("oak-d-pro", (48, 30)), scene, 0.0, 1, cache=cache),
    ]
    for camera in cameras:
        camera.still_view(T, rng)
    cameras[0].still_view(T + np.eye(4, k=3) * 0.001, rng)
    assert len(list(tmp_path.iterdir())) == len(cameras) + 1
    cameras[4].still_view(T, rng, with_dots=False)
    assert len(list(tmp_path.iterdir())) == len(cameras) + 2
    cameras[0].still_view(T, rng, with_dots=False)
    assert len(list(tmp_path.iterdir())) == len(cameras) + 2, "a projector without power changes nothing"
