"""Names of base, flange and camera frame in a bag, and the camera pose on the flange."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cell.bag.errors import BagError, listed
from cell.bag.tf_tree import LOOSE_M, LOOSE_RAD, UNKNOWN, TransformTree
from cell.recording.errors import shown

BASES = ("base", "base_link")
"""Usual names of the base. `base` is the frame of UR's controller and of this program; ROS's `base_link` is turned by
180 degrees about z."""
FLANGES = ("tool0", "flange")
"""Usual names of the flange. `tool0` is the flange of UR's controller, with z outwards; ROS's `flange` has x there."""


@dataclass(frozen=True)
class Frames:
    """Names of the frames in /tf."""

    base: str
    flange: str
    camera: str


def find_frames(tree: TransformTree, base: str | None, flange: str | None, camera: str) -> Frames:
    """Return the given frames, or those with the usual names.

    Args:
        tree: Transforms of the bag.
        base: Name of the base frame, or None.
        flange: Name of the flange frame, or None.
        camera: Name of the camera frame.

    Raises:
        BagError: There is no such frame.
    """
    return Frames(
        base or _known(tree, BASES, "base", "--base-frame"),
        flange or _known(tree, FLANGES, "flange", "--flange-frame"),
        camera,
    )


def fixed_camera(tree: TransformTree, frames: Frames, stamps_ns: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return `T_flange_camera` (4, 4), which must be constant.

    Args:
        tree: Transforms of the bag.
        frames: Names of the frames.
        stamps_ns: Times (N,) of the images, nanoseconds.

    Raises:
        BagError: /tf does not contain it, or it changes.
    """
    try:
        poses, known = tree.chain(frames.flange, frames.camera).at(stamps_ns)
    except BagError as error:
        raise BagError(
            f"the pose of the camera on the flange is unknown: {error}; name a file by --hand-eye"
        ) from error
    if (known == UNKNOWN).any():
        raise BagError(
            f"the pose of {shown(frames.camera)!r} in {shown(frames.flange)!r} is not known at all times: "
            "name a file by --hand-eye"
        )
    moved_m, turned_rad = poses.distance(0, poses)
    if moved_m > LOOSE_M or turned_rad > LOOSE_RAD:
        raise BagError(
            f"the camera {shown(frames.camera)!r} is not fixed to {shown(frames.flange)!r}: it moves by up to "
            f"{moved_m * 1000:.1f} mm and {np.degrees(turned_rad):.2f} degrees in it: name the frame "
            "that carries the camera by --flange-frame; a camera that stands in the cell cannot be imported"
        )
    return poses.matrix(0)


def _known(tree: TransformTree, names: tuple[str, ...], what: str, option: str) -> str:
    found = next((name for name in names if name in tree.frames), None)
    if found is None:
        raise BagError(
            f"/tf has no frame {' or '.join(names)}: name the {what} by {option}; its frames: {listed(tree.frames)}"
        )
    return found
