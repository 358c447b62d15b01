"""Depth images that were taken while the arm stood still, grouped by its position."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cell.bag.errors import BagError
from cell.bag.tf_tree import ALONE, KNOWN, SAME_M, SAME_RAD, Chain

WINDOW_S = 0.25
"""Time before and after an image during which the pose of a resting arm stays the same. At less than 2 mm/s, the motion
during one view is below the noise of depth."""
MAX_FRAMES = 5
"""Largest number of images of one view, as in a live scan."""


@dataclass(frozen=True, eq=False)
class StationaryPose:
    """A position at which the arm stood still, with its images."""

    frames: tuple[int, ...]
    """Indices of the images in the order of their stamps, from the middle of the stay."""
    T_base_flange: NDArray[np.float64]
    """(4, 4) flange pose at the middle image."""
    stamp_ns: int
    """Stamp of the middle image, nanoseconds."""


@dataclass(frozen=True, eq=False)
class StationaryPoses:
    """Result of `find_stationary_poses`."""

    poses: tuple[StationaryPose, ...]
    """Positions in the order of time."""
    moving: int
    """Number of images that were taken while the arm moved."""
    unknown: int
    """Number of images for which the pose of the arm is unknown."""
    single: bool
    """Whether poses are too far apart in time to tell whether the arm moved, and every image has its own pose."""


def find_stationary_poses(chain: Chain, stamps_ns: NDArray[np.int64]) -> StationaryPoses:
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
    pose_stamps_ns = chain.stamps_ns
    if len(pose_stamps_ns) and not known.any():
        apart_s = max(stamps_ns[0] - pose_stamps_ns[-1], pose_stamps_ns[0] - stamps_ns[-1], 0) / 1e9
        raise BagError(
            f"/tf has no flange pose for any of the {len(stamps_ns)} depth images"
            + (
                f": its stamps differ from those of the images by {apart_s:.1f} s; synchronise the two clocks"
                if apart_s
                else ""
            )
        )
    within = (
        (stamps_ns >= pose_stamps_ns[0]) & (stamps_ns <= pose_stamps_ns[-1])
        if len(pose_stamps_ns)
        else np.ones(len(known), bool)
    )
    usable = known == KNOWN
    if (known[within] >= ALONE).all():
        usable |= known == ALONE
    known_poses, _ = chain.at(pose_stamps_ns)
    window_ns = round(WINDOW_S * 1e9)
    first, last = (
        np.searchsorted(pose_stamps_ns, stamps_ns - window_ns),
        np.searchsorted(pose_stamps_ns, stamps_ns + window_ns, "right"),
    )
    groups: list[list[int]] = []
    moving = 0
    has_left = True
    """Whether the arm has left the position of the last group."""
    for k in np.flatnonzero(usable).tolist():
        if not _is_same_pose(poses.distance(k, known_poses[first[k] : last[k]])):
            moving, has_left = moving + 1, True
            continue
        if has_left or not _is_same_pose(poses.distance(groups[-1][0], poses[k : k + 1])):
            groups.append([])
        has_left = False
        groups[-1].append(k)
    stationary_poses = []
    for group in groups:
        frames = _middle_frames(group)
        at = frames[len(frames) // 2]
        stationary_poses.append(StationaryPose(tuple(frames), poses.matrix(at), int(stamps_ns[at])))
    taken = [frame for pose in stationary_poses for frame in pose.frames]
    single = bool((known[taken] == ALONE).any())
    return StationaryPoses(tuple(stationary_poses), moving, int(np.count_nonzero(~usable)), single)


def _is_same_pose(distance: tuple[float, float]) -> bool:
    return distance[0] <= SAME_M and distance[1] <= SAME_RAD


def _middle_frames(frames: list[int]) -> list[int]:
    """Return the middle images. During the first one the arm may still shake, and during the last one it may move."""
    skip = max(len(frames) - MAX_FRAMES, 0) // 2
    return frames[skip : skip + MAX_FRAMES]
