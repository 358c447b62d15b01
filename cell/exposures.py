"""From single depth images to one frame of a scene at rest."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cell.devices import Frame
from cell.errors import BadFrameError

LEAST_MEASURED = 0.01
"""An image with a smaller share of measured pixels shows nothing."""


class NoFramesError(BadFrameError):
    """The camera is silent: a new connection may wake it."""


@dataclass(frozen=True, eq=False)
class Exposure:
    """One depth image."""

    depth: NDArray[np.uint16]
    """(H, W), depth units; 0 = not measured."""
    K: NDArray[np.float64]
    """(3, 3) pinhole matrix, pixels."""
    began_s: float
    """When its exposure began, seconds of `time.monotonic()`."""


def at_rest(
    receive: Callable[[float], Exposure | None], after_s: float, count: int, silence_s: float, patience_s: float
) -> list[Exposure]:
    """The first `count` exposures that began after `after_s`, seconds of `time.monotonic()`.

    `receive` waits for the next exposure for at most so many seconds and gives None if none came. What comes within
    `silence_s` of the one before, or of the call or of `after_s`, is in time; all must be there `patience_s` after the
    later of the call and `after_s`.

    Raises:
        NoFramesError: nothing came in time.
        BadFrameError: exposures came, but too few of them began after `after_s`.
    """
    taken: list[Exposure] = []
    last = max(time.monotonic(), after_s)
    end = last + patience_s
    dropped = 0
    while len(taken) < count:
        now = time.monotonic()
        if now > end:
            raise BadFrameError(
                f"only {len(taken)} of {count} frames began after the arm came to rest, in {patience_s:.1f} s "
                f"({dropped} older ones came): the camera is too slow, or its clock is wrong"
            )
        exposure = receive(min(max(last + silence_s - now, 0.0), end - now))
        if exposure is None:
            if time.monotonic() >= last + silence_s:
                raise NoFramesError(
                    f"the camera has sent no frame for {silence_s:.1f} s: check its cable and power supply"
                )
            continue
        last = max(last, time.monotonic())
        if exposure.began_s > after_s:
            taken.append(exposure)
        else:
            dropped += 1
    return taken


def combined(exposures: Sequence[Exposure], depth_unit_m: float) -> Frame:
    """The frame that several exposures of a scene at rest give: their median, checked.

    Raises:
        BadFrameError: they show nothing, or do not belong together.
    """
    first = exposures[0]
    for exposure in exposures:
        if exposure.depth.shape != first.depth.shape or not np.array_equal(exposure.K, first.K):
            raise BadFrameError("the camera's resolution or intrinsics changed within one look: connect it again")
    depth = median([exposure.depth for exposure in exposures])
    _check(depth)
    # The epoch's clock is asked only here: whoever sets it cannot upset the waiting.
    began_s = exposures[-1].began_s + time.time() - time.monotonic()
    return Frame(depth, depth_unit_m, first.K, began_s, len(exposures))


def median(depths: Sequence[NDArray[np.uint16]]) -> NDArray[np.uint16]:
    """The median (H, W) of depth images (H, W) at each pixel, over those that measured it.

    A pixel that no majority measured is 0. Of an even number the nearer of the middle two is taken: a mean of string
    and table would be a place where nothing is.
    """
    ordered = np.sort(np.stack(depths), axis=0)
    measured = np.count_nonzero(ordered, axis=0)
    # The zeros come first.
    middle = len(depths) - measured + (measured - 1) // 2
    picked = np.take_along_axis(ordered, np.minimum(middle, len(depths) - 1)[None], axis=0)[0]
    return np.where(2 * measured > len(depths), picked, 0).astype(np.uint16)


def _check(depth: NDArray[np.uint16]) -> None:
    share = np.count_nonzero(depth) / depth.size
    if share == 0:
        raise BadFrameError(
            "the depth image is all zero: nothing is within the camera's range, it is dark, or a lens is covered"
        )
    if share < LEAST_MEASURED:
        raise BadFrameError(
            f"only {share:.2%} of the depth image are measured: too near, too dark, or a surface without texture"
        )
    values = depth[depth > 0]
    if values.min() == values.max():
        raise BadFrameError(
            f"the depth image has the same depth at all measured pixels ({values[0]} counts): the stereo matching of "
            "the camera has failed; unplug it and plug it in again"
        )
