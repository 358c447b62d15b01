"""Which depth images of a bag were taken while the arm stood still, and which of them from one place."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cell.bag.errors import BagError
from cell.bag.tf_tree import ALONE, KNOWN, SAME_M, SAME_RAD, Chain

WINDOW_S = 0.25
"""The arm stands still when its pose stays the same for so long before and after an image: what is slower than 2 mm/s
moves less during the images of one view than depth is noisy."""
MOST_FRAMES = 5
"""Of one view: as many as a live scan takes."""


@dataclass(frozen=True, eq=False)
class Place:
    """Where the arm stood still, and what was seen from there."""

    frames: tuple[int, ...]
    """Places of the images in the order of their stamps: those in the middle of the time there."""
    T_base_flange: NDArray[np.float64]
    """(4, 4) at the middle one of them."""
    stamp_ns: int
    """Of that one."""


@dataclass(frozen=True, eq=False)
class Rest:
    """What `find_rest` gives."""

    places: tuple[Place, ...]
    """In the order of time."""
    moving: int
    """So many images were taken while the arm moved."""
    unknown: int
    """Of so many it is not told where the arm was."""
    single: bool
    """Poses are too far apart in time to tell whether the arm moved: images were taken for which one was told alone."""


def find_rest(chain: Chain, stamps_ns: NDArray[np.int64]) -> Rest:
    """The places where the arm stood still while images with the stamps (N,), increasing, were taken.

    Images in a row with the same pose are of one place. Where /tf has gaps, a pose beside an image is enough only
    when every image has one: then the bag is of single images, each taken at rest, and not of a moving camera.

    Raises:
        BagError: of no image it is known where the arm was.
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
    """The arm has left the place of the last group."""
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
    """The middle ones: the first may still shake, the last may already go."""
    skip = max(len(frames) - MOST_FRAMES, 0) // 2
    return frames[skip : skip + MOST_FRAMES]
