"""Depth images that were taken while the arm stood still, grouped by its position."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cell.bag.errors import BagError
from cell.bag.tf_tree import ALONE, KNOWN, SAME_M, SAME_RAD, Chain

WINDOW_S = 0.25
"""Time before and after an image during which the pose of a resting arm stays the same. At less than 2 mm/s, the motion
during one view is below the noise of depth."""
MOST_FRAMES = 5
"""Largest number of images of one view, as in a live scan."""


@dataclass(frozen=True, eq=False)
class Place:
    """A position at which the arm stood still, with its images."""

    frames: tuple[int, ...]
    """Indices of the images in the order of their stamps, from the middle of the stay."""
    T_base_flange: NDArray[np.float64]
    """(4, 4) flange pose at the middle image."""
    stamp_ns: int
    """Stamp of the middle image, nanoseconds."""


@dataclass(frozen=True, eq=False)
class Rest:
    """Result of `find_rest`."""

    places: tuple[Place, ...]
    """Positions in the order of time."""
    moving: int
    """Number of images that were taken while the arm moved."""
    unknown: int
    """Number of images for which the pose of the arm is unknown."""
    single: bool
    """Whether poses are too far apart in time to tell whether the arm moved, and every image has its own pose."""


def find_rest(chain: Chain, stamps_ns: NDArray[np.int64]) -> Rest:
    """Return the positions at which the arm stood still while images were taken.

    Consecutive images with the same pose belong to one position. Where /tf has gaps, one pose beside an image is enough
    only if every image has one. Then the bag consists of single images at rest, and not of a moving camera.

    Args:
        chain: Transforms from the flange to the base.
        stamps_ns: Times (N,) of the images, increasing, nanoseconds.

    Raises:
        BagError: The pose of the arm is known for no image.
    """
    poses, known = chain.at(stamps_ns)
    told_ns = chain.stamps_ns
    if len(told_ns) and not known.any():
        apart_s = max(stamps_ns[0] - told_ns[-1], told_ns[0] - stamps_ns[-1], 0) / 1e9
        raise BagError(
            f"of none of the {len(stamps_ns)} depth images it is told where the flange was"
            + (f": the times in /tf lie {apart_s:.1f} s beside the images' (two clocks?)" if apart_s else "")
        )
    within = (stamps_ns >= told_ns[0]) & (stamps_ns <= told_ns[-1]) if len(told_ns) else np.ones(len(known), bool)
    usable = known == KNOWN
    if (known[within] >= ALONE).all():
        usable |= known == ALONE
    told, _ = chain.at(told_ns)
    window_ns = round(WINDOW_S * 1e9)
    first, last = (
        np.searchsorted(told_ns, stamps_ns - window_ns),
        np.searchsorted(told_ns, stamps_ns + window_ns, "right"),
    )
    groups: list[list[int]] = []
    moving = 0
    gone = True
    """Whether the arm has left the position of the last group."""
    for k in np.flatnonzero(usable).tolist():
        if not _same(poses.distance(k, told[first[k] : last[k]])):
            moving, gone = moving + 1, True
            continue
        if gone or not _same(poses.distance(groups[-1][0], poses[k : k + 1])):
            groups.append([])
        gone = False
        groups[-1].append(k)
    places = []
    for group in groups:
        frames = _middle(group)
        at = frames[len(frames) // 2]
        places.append(Place(tuple(frames), poses.matrix(at), int(stamps_ns[at])))
    taken = [frame for place in places for frame in place.frames]
    single = bool((known[taken] == ALONE).any())
    return Rest(tuple(places), moving, int(np.count_nonzero(~usable)), single)


def _same(distance: tuple[float, float]) -> bool:
    return distance[0] <= SAME_M and distance[1] <= SAME_RAD


def _middle(frames: list[int]) -> list[int]:
    """Return the middle images. During the first one the arm may still shake, and during the last one it may move."""
    skip = max(len(frames) - MOST_FRAMES, 0) // 2
    return frames[skip : skip + MOST_FRAMES]
