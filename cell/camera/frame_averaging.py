"""Combination of several exposures of a scene at rest to one frame."""

import logging
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from cell.devices import Burst, Frame
from cell.errors import BadFrameError

log = logging.getLogger(__name__)

MIN_MEASURED_SHARE = 0.01
"""Smallest share of measured pixels of a usable depth image."""
MIN_CONTRAST = 10
"""Smallest difference between dark and bright pixels of a usable picture, grey levels. Noise alone gives about half."""
DARK_AND_BRIGHT = 0.01, 0.99
"""Quantiles of the brightness at which pixels count as dark and as bright."""
SAME_K_PX = 0.05
"""Largest difference between two matrices of one camera, which are reported in single precision."""


class NoFramesError(BadFrameError):
    """The camera is silent. A new connection may help."""


@dataclass(frozen=True, eq=False)
class Exposure:
    """One depth image."""

    depth: NDArray[np.uint16]
    """Depth image (H, W) in depth units; 0 = not measured."""
    K: NDArray[np.float64]
    """(3, 3) pinhole matrix, pixels."""
    began_s: float
    """Start of the exposure, seconds of `time.monotonic()`."""
    number: int = 0
    """Number of the exposure. The depth image and the intensity image of one exposure have the same number."""


@dataclass(frozen=True, eq=False)
class Picture:
    """One intensity image of the camera that takes the depth images."""

    pixels: NDArray[np.uint8]
    """Grey image (H, W), or colour image (H, W, 3) in the order blue, green, red."""
    K: NDArray[np.float64]
    """(3, 3) pinhole matrix, pixels."""
    began_s: float
    """Start of the exposure, seconds of `time.monotonic()`."""
    number: int = 0
    """Number of the exposure. The depth image and the intensity image of one exposure have the same number."""


Image = TypeVar("Image", Exposure, Picture)


def wait_for_exposures(
    receive: Callable[[float], Image | None],
    after_s: float,
    count: int,
    silence_s: float,
    patience_s: float,
    what: str = "frame",
) -> list[Image]:
    """Return the first `count` exposures that began after `after_s`.

    Args:
        receive: Waits for the next exposure for at most the given seconds. It returns None if none came.
        after_s: Earliest start of an exposure, seconds of `time.monotonic()`.
        count: Number of exposures.
        silence_s: Longest time between two exposures, and from the later of the call and `after_s` to the first one.
        patience_s: Longest time from the later of the call and `after_s` to the last exposure.
        what: Word for one exposure in the errors.

    Raises:
        NoFramesError: No exposure came within `silence_s`.
        BadFrameError: Exposures came, but too few of them began after `after_s`.
    """
    taken: list[Image] = []
    last = max(time.monotonic(), after_s)
    end = last + patience_s
    dropped = 0
    while len(taken) < count:
        now = time.monotonic()
        if now > end:
            raise BadFrameError(
                f"only {len(taken)} of {count} {what}s began after the arm came to rest, in {patience_s:.1f} s "
                f"({dropped} older ones came): the camera is too slow, or its clock is wrong"
            )
        exposure = receive(min(max(last + silence_s - now, 0.0), end - now))
        if exposure is None:
            if time.monotonic() >= last + silence_s:
                raise NoFramesError(
                    f"the camera has sent no {what} for {silence_s:.1f} s: check its cable and power supply"
                )
            continue
        last = max(last, time.monotonic())
        if exposure.began_s > after_s:
            taken.append(exposure)
        else:
            dropped += 1
    return taken


def combine(
    exposures: Sequence[Exposure],
    depth_unit_m: float,
    pictures: Sequence[Picture] = (),
    left_images: Sequence[Picture] = (),
) -> Frame:
    """Combine exposures of a scene at rest to the median of their depth and the means of their images.

    Args:
        exposures: Depth images of one size and matrix.
        depth_unit_m: Metres per depth count.
        pictures: Images for a calibration of the same size and matrix, or none.
        left_images: Grey images of these exposures, or none. Images of another size or matrix are left out with a
            warning in the log, because a scan does not need them.

    Raises:
        BadFrameError: The images show nothing, differ in size or matrix, or are no (H, W) arrays of uint16.
    """
    first = _require_alike(exposures)
    image = _image(pictures, first) if pictures else None
    depth = median([exposure.depth for exposure in exposures])
    _check(depth)
    # The epoch's clock is read only here. Setting it during a capture does not affect the waiting.
    began_s = exposures[-1].began_s + time.time() - time.monotonic()
    intensity = _intensity(left_images, first)
    return Frame(depth, depth_unit_m, first.K, began_s, len(exposures), image=image, intensity=intensity)


def as_burst(exposures: Sequence[Exposure], depth_unit_m: float) -> Burst:
    """Return exposures of a scene at rest side by side, without combining them.

    Args:
        exposures: Depth images of one size and matrix.
        depth_unit_m: Metres per depth count.

    Raises:
        BadFrameError: The images differ in size or matrix, or are no (H, W) arrays of uint16.
    """
    _require_alike(exposures)
    began_s = np.array([exposure.began_s for exposure in exposures])
    return Burst(np.stack([exposure.depth for exposure in exposures]), depth_unit_m, began_s)


def _require_alike(exposures: Sequence[Exposure]) -> Exposure:
    """Return the first exposure. Raise BadFrameError unless all are depth images of its size and matrix."""
    first = exposures[0]
    for exposure in exposures:
        if exposure.depth.dtype != np.uint16 or exposure.depth.ndim != 2:
            raise BadFrameError(
                f"the camera's driver returned a depth image of shape {exposure.depth.shape} and type "
                f"{exposure.depth.dtype}; (height, width) and uint16 are needed"
            )
        if exposure.depth.shape != first.depth.shape or not np.array_equal(exposure.K, first.K):
            raise BadFrameError("the camera's resolution or intrinsics changed within one capture: connect it again")
    return first


def median(depths: Sequence[NDArray[np.uint16]]) -> NDArray[np.uint16]:
    """Return the median (H, W) of depth images (H, W) at each pixel, over the images that measured the pixel.

    A pixel that no majority measured is 0. Of an even number, the nearer of the middle two values is taken. The mean of
    a string and the table would be a point in free space.
    """
    ordered = np.sort(np.stack(depths), axis=0)
    measured = np.count_nonzero(ordered, axis=0)
    # The zeros come first in the order.
    middle = len(depths) - measured + (measured - 1) // 2
    picked = np.take_along_axis(ordered, np.minimum(middle, len(depths) - 1)[None], axis=0)[0]
    return np.where(2 * measured > len(depths), picked, 0).astype(np.uint16)


def mean_image(images: Sequence[NDArray[np.uint8]]) -> NDArray[np.uint8]:
    """Return the rounded mean of images of one shape at each pixel.

    It has less noise than one of the images or their median. Nothing blurs, because the scene is at rest.
    """
    mean = np.mean(images, axis=0, dtype=np.float32)
    return np.rint(mean).astype(np.uint8)


def _intensity(left_images: Sequence[Picture], exposure: Exposure) -> NDArray[np.uint8] | None:
    """Return the mean of the images of the exposures, or None if there are none that fit the depth image."""
    for image in left_images:
        if image.pixels.shape != exposure.depth.shape or _matrix_difference(image.K, exposure.K) > SAME_K_PX:
            log.warning(
                "the view has no intensity image: the camera's image (%s) does not fit its depth image (%s)",
                _pinhole(image.K, image.pixels.shape),
                _pinhole(exposure.K, exposure.depth.shape),
            )
            return None
    return mean_image([image.pixels for image in left_images]) if left_images else None


def _matrix_difference(a: NDArray[np.float64], b: NDArray[np.float64]) -> float:
    return float(np.abs(a - b).max())


def _image(pictures: Sequence[Picture], exposure: Exposure) -> NDArray[np.uint8]:
    """Return the mean of the pictures. Raise BadFrameError if they do not fit the depth image or show nothing."""
    first = pictures[0]
    for picture in pictures:
        if picture.pixels.shape != first.pixels.shape or not np.array_equal(picture.K, first.K):
            raise BadFrameError(
                "the picture's resolution or intrinsics changed within one capture: connect the camera again"
            )
    if first.pixels.shape[:2] != exposure.depth.shape or _matrix_difference(first.K, exposure.K) > SAME_K_PX:
        raise BadFrameError(
            f"the camera's picture ({_pinhole(first.K, first.pixels.shape)}) does not fit its depth image "
            f"({_pinhole(exposure.K, exposure.depth.shape)}), so that a calibration by the one would be wrong for the "
            "other: connect the camera again, and if it stays so, check its firmware and factory calibration"
        )
    image = mean_image([picture.pixels for picture in pictures])
    grey = image if image.ndim == 2 else image[..., 1]
    share = np.cumsum(np.bincount(grey.ravel(), minlength=256)) / grey.size
    dark, bright = (int(level) for level in np.searchsorted(share, DARK_AND_BRIGHT))
    if bright - dark < MIN_CONTRAST:
        raise BadFrameError(
            f"the camera's picture shows nothing (grey levels {dark} to {bright} of 255): a lens is covered, it is "
            "dark, or the light is far too bright"
        )
    return image


def _pinhole(K: NDArray[np.float64], shape: tuple[int, ...]) -> str:
    """Return size and matrix for a message."""
    focal, centre = f"{K[0, 0]:.2f}, {K[1, 1]:.2f}", f"{K[0, 2]:.2f}, {K[1, 2]:.2f}"
    return f"{shape[1]}x{shape[0]}, focal lengths {focal}, centre {centre} pixels"


def _check(depth: NDArray[np.uint16]) -> None:
    share = np.count_nonzero(depth) / depth.size
    if share == 0:
        raise BadFrameError(
            "the depth image is all zero: nothing is within the camera's range, it is dark, or a lens is covered"
        )
    if share < MIN_MEASURED_SHARE:
        raise BadFrameError(
            f"only {share:.2%} of the depth image are measured: too near, too dark, or a surface without texture"
        )
    values = depth[depth > 0]
    if values.min() == values.max():
        raise BadFrameError(
            f"the depth image has the same depth at all measured pixels ({values[0]} counts): the stereo matching of "
            "the camera has failed; unplug it and plug it in again"
        )
