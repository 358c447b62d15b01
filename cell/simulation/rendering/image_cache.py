"""Rendered images that are kept on the disk between runs.

A simulated cell shows the same scene from the same poses in every scan, so its images need to be rendered only once.
Each file holds the two images from one pose, before the noise of the sensor. Its name is a hash of everything that the
images depend on. The library diskcache would do the same, but is no longer maintained and unpickles what it reads.
"""

import hashlib
import logging
import os
import tempfile
import time
import zipfile
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import numpy as np
import platformdirs
from numpy.typing import NDArray

from cell.simulation.rendering.stereo_camera import StillPair

log = logging.getLogger(__name__)

RENDERER_VERSION = 1
"""Number that is increased whenever the renderer gives other images for the same scene and pose."""
KEPT_SHARE = 0.9
"""Share of the size that remains when the oldest files are removed."""
ABANDONED_S = 3600.0
"""Age of an unfinished file whose process has ended, seconds."""
_SUFFIX = ".npz"
_PARTIAL = ".partial"


def cache_folder() -> Path:
    """Return the folder of the images. `XDG_CACHE_HOME` moves it on Linux."""
    return platformdirs.user_cache_path("pointchain", appauthor=False) / "simulated-images"


class ImageCache:
    """A folder of rendered images with a bounded size. Several processes may use it at the same time."""

    def __init__(self, max_bytes: int, folder: Path | None = None) -> None:
        """Create the cache; the folder is made when the first images are kept.

        Args:
            max_bytes: Largest size of all files. 0 keeps nothing.
            folder: Folder of the files. None: `cache_folder`.
        """
        self._max_bytes = max_bytes
        self._folder = folder or cache_folder()

    def get(self, key: str, shape: tuple[int, int], render: Callable[[], StillPair]) -> StillPair:
        """Return the images of a key: those on the disk, or newly rendered ones, which are kept.

        A file that is damaged is rendered again. A disk that cannot be written switches the cache off.

        Args:
            key: Hexadecimal hash of everything that the images depend on.
            shape: Height and width of the images.
            render: Renders the images.
        """
        if self._max_bytes == 0:
            return render()
        path = self._folder / f"{key}{_SUFFIX}"
        found = self._read(path, shape)
        if found is not None:
            return found
        pair = render()
        try:
            self._write(path, pair)
            self._remove_oldest()
        except OSError as error:
            log.warning("rendered images are not kept: %s cannot be written: %s", self._folder, error.strerror)
            self._max_bytes = 0
        return pair

    def _read(self, path: Path, shape: tuple[int, int]) -> StillPair | None:
        """Return the images of a file, or None if there is none, or none that can be used."""
        try:
            # An open file is given, because np.load does not close one that it cannot read.
            with path.open("rb") as opened, np.load(opened, allow_pickle=False) as arrays:
                left = arrays["left"]
                right = arrays["right"]
            _check_image(left, shape)
            _check_image(right, shape)
        except FileNotFoundError:
            return None
        except (OSError, EOFError, KeyError, ValueError, zipfile.BadZipFile) as error:
            log.warning("%s is damaged, so its images are rendered again: %s", path, error)
            return None
        with suppress(OSError):
            os.utime(path)  # the oldest files are removed first
        return StillPair(left, right)

    def _write(self, path: Path, pair: StillPair) -> None:
        """Write a file completely or not at all."""
        self._folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        with tempfile.NamedTemporaryFile(dir=self._folder, suffix=_PARTIAL, delete=False) as file:
            unfinished = Path(file.name)
            try:
                np.savez(file, left=pair.left, right=pair.right)
                file.close()
                unfinished.replace(path)
            finally:
                unfinished.unlink(missing_ok=True)

    def _remove_oldest(self) -> None:
        """Remove files that were not used for the longest time, if all together are too large."""
        kept: list[tuple[float, int, Path]] = []
        for entry in os.scandir(self._folder):
            with suppress(FileNotFoundError):  # another process removed it
                status = entry.stat()
                is_abandoned = entry.name.endswith(_PARTIAL) and time.time() - status.st_mtime > ABANDONED_S
                if is_abandoned:
                    Path(entry.path).unlink(missing_ok=True)
                elif entry.name.endswith(_SUFFIX):
                    kept.append((status.st_mtime, status.st_size, Path(entry.path)))
        total = sum(size for _, size, _ in kept)
        if total <= self._max_bytes:
            return
        for _, size, path in sorted(kept):
            if total <= KEPT_SHARE * self._max_bytes:
                break
            path.unlink(missing_ok=True)
            total -= size


def image_key(*parts: NDArray[np.generic] | str | float | None) -> str:
    """Return the hash of everything that images depend on, and of the version of the renderer.

    Args:
        *parts: Arrays and values in a fixed order.
    """
    digest = hashlib.sha256(f"renderer {RENDERER_VERSION}".encode())
    for part in parts:
        if isinstance(part, np.ndarray):
            digest.update(f"|{part.dtype.str}{part.shape}|".encode())
            digest.update(np.ascontiguousarray(part).tobytes())
        else:
            digest.update(f"|{part!r}|".encode())
    return digest.hexdigest()


def _check_image(image: NDArray[np.generic], shape: tuple[int, int]) -> None:
    """Raise ValueError if an image is not a grey image of the shape."""
    if image.shape != shape or image.dtype != np.float32:
        raise ValueError(f"it has an image of {image.shape} {image.dtype}, not of {shape} float32")
