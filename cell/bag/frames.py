"""Which frames of a bag are base, flange and camera, and how the camera sits on the flange."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cell.bag.errors import BagError, listed
from cell.bag.tf_tree import LOOSE_M, LOOSE_RAD, UNKNOWN, TransformsTree
from cell.recording.errors import shown

BASES = ("base", "base_link")
"""`base` first: UR's controller and all of this program mean it; ROS's `base_link` is turned by 180 degrees about z."""
FLANGES = ("tool0", "flange")
"""`tool0` first: it is the flange as UR's controller has it, with z away from the arm; ROS's `flange` has x there."""


@dataclass(frozen=True)
class Frames:
    """The names in /tf."""

    base: str
    flange: str
    camera: str


def find_frames(tree: TransformsTree, base: str | None, flange: str | None, camera: str) -> Frames:
    """The frames that were named, else what they are usually called.

    Raises:
        BagError: there is no such frame.
    """
    return Frames(
        base or _known(tree, BASES, "base", "--base-frame"),
        flange or _known(tree, FLANGES, "flange", "--flange-frame"),
        camera,
    )


def fixed_camera(tree: TransformsTree, frames: Frames, stamps_ns: NDArray[np.int64]) -> NDArray[np.float64]:
    """`T_flange_camera` (4, 4), which must be the same at all moments (N,).

    Raises:
        BagError: /tf does not tell it, or it changes.
    """
    try:
        poses, known = tree.chain(frames.flange, frames.camera).at(stamps_ns)
    except BagError as error:
        raise BagError(
            f"where the camera sits on the flange is not told: {error}; name a file by --hand-eye"
        ) from error
    if (known == UNKNOWN).any():
        raise BagError(
            f"where {shown(frames.camera)!r} is in {shown(frames.flange)!r} is not told at all times: name a file by "
            "--hand-eye"
        )
    moved_m, turned_rad = poses.distance(0, poses)
    if moved_m > LOOSE_M or turned_rad > LOOSE_RAD:
        raise BagError(
            f"the camera {shown(frames.camera)!r} is not fixed to {shown(frames.flange)!r}: it moves by up to "
            f"{moved_m * 1000:.1f} mm and {np.degrees(turned_rad):.2f} degrees in it; is that the frame that carries "
            "it (--flange-frame), and does the camera not stand in the cell?"
        )
    return poses.matrix(0)


def _known(tree: TransformsTree, names: tuple[str, ...], what: str, option: str) -> str:
    found = next((name for name in names if name in tree.frames), None)
    if found is None:
        raise BagError(
            f"/tf has no frame {' or '.join(names)}: name the {what} by {option}; its frames: {listed(tree.frames)}"
        )
    return found
