"""Reach of the grasps of scans: whether the configured cell can carry them out. Found on request, and remembered."""

from collections import OrderedDict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from calibration.storage.hand_eye_file import HandEye
from cell.config.cell_config import CellSettings
from cell.planning.grasp_reach import GraspReach, ReachModel, find_reach, reach_model
from cell.planning.home import home_posture
from recognition.grasping.flange_poses import flange_poses
from recognition.grasping.gripper import Gripper
from recognition.model.grasps import Grasp
from recognition.preprocessing.height_map import HeightMap

BATCH = 20
"""Number of grasps whose reach is found together."""
MAX_SCANS = 16
"""Number of scans whose reach is remembered."""
MIN_HEIGHT_M = 0.02
"""Minimum height above the table of an object from which arm and camera keep clear, metres. They stay farther from the
table than that."""
BLOCK_M = 0.01
"""Edge length of the blocks of the table whose highest points stand for the objects, metres."""


@dataclass(frozen=True, eq=False)
class _Known:
    """What is known about the reach of one scan's grasps."""

    model: ReachModel
    """Reach model of the cell, with what lies on the table."""
    by_id: dict[int, GraspReach] = field(default_factory=dict)
    """Reach of the grasps that were asked for, by their ids."""


class ReachFinder:
    """Finds the reach of grasps by one cell, from its home posture. Used by one thread at a time."""

    def __init__(self, settings: CellSettings) -> None:
        """Create the finder.

        Args:
            settings: Settings of the cell.
        """
        self._settings = settings
        self._known: OrderedDict[tuple[str, str, Gripper], _Known] = OrderedDict()
        self._home: tuple[str, NDArray[np.float64]] | None = None

    def home_q_rad(self, hand_eye: HandEye) -> NDArray[np.float64]:
        """Return the joint angles (6,) of the home posture, from which the arm moves to a pre-grasp.

        Raises:
            ViewpointsError: No home posture is free.
        """
        if self._home is None or self._home[0] != hand_eye.sha256:
            self._home = hand_eye.sha256, home_posture(self._settings, hand_eye.T_flange_camera)
        return self._home[1]

    def find(
        self,
        scan: str,
        grasps: Sequence[Grasp],
        gripper: Gripper,
        hand_eye: HandEye,
        heights: tuple[HeightMap, float] | None,
    ) -> Iterator[tuple[Grasp, GraspReach]]:
        """Yield the grasps with their reach, in their order. The work is done as far as they are taken.

        Args:
            scan: Id of the scan.
            grasps: Grasps of its model.
            gripper: Gripper for which they were planned.
            hand_eye: Hand-eye calibration of the camera in the cell.
            heights: Height map of the scan and height of its table, metres. None: nothing but strings is on the table.

        Raises:
            ViewpointsError: No home posture is free.
        """
        key = (scan, hand_eye.sha256, gripper)
        known = self._known.get(key)
        if known is None:
            points = None if heights is None else heights[0].peaks(heights[1] + MIN_HEIGHT_M, BLOCK_M)
            home = self.home_q_rad(hand_eye)
            known = _Known(reach_model(self._settings, hand_eye.T_flange_camera, gripper, home, points))
            self._known[key] = known
            if len(self._known) > MAX_SCANS:
                self._known.popitem(last=False)
        self._known.move_to_end(key)
        for start in range(0, len(grasps), BATCH):
            batch = grasps[start : start + BATCH]
            _complete(known, batch, gripper)
            for grasp in batch:
                yield grasp, known.by_id[grasp.id]


def _complete(known: _Known, grasps: Sequence[Grasp], gripper: Gripper) -> None:
    """Find the reach of the grasps for which it is not known."""
    new = [grasp for grasp in grasps if grasp.id not in known.by_id]
    if not new:
        return
    poses = flange_poses(np.array([grasp.T_base_grasp for grasp in new]), [grasp.reach_m for grasp in new], gripper)
    found = find_reach(known.model, poses, np.array([grasp.opening_m for grasp in new]))
    known.by_id.update({grasp.id: reach for grasp, reach in zip(new, found, strict=True)})
