"""JSON document of the grasps of a scan, with their reach by the configured cell. Metres, radians, base frame."""

from collections.abc import Sequence
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BeforeValidator, ConfigDict, Field

from cell.planning.grasp_reach import GraspReach, ReachReason
from recognition.grasping.flange_poses import FlangePoses, flange_poses
from recognition.grasping.gripper import Gripper
from recognition.model.document import GraspDocument, GraspMotionDocument, Row
from recognition.model.grasps import GraspMotion
from service.api.schemas.base import ApiModel

Pose = tuple[Row, Row, Row, Row]
ANGLE_DECIMALS = 9
"""Decimals of joint angles. The flange is then within some nanometres."""


def _rounded(q_rad: Any) -> Any:
    """Round an array of joint angles. Other values stay as they are."""
    return tuple(q_rad.round(ANGLE_DECIMALS).tolist()) if isinstance(q_rad, np.ndarray) else q_rad


Joints = Annotated[tuple[float, float, float, float, float, float], BeforeValidator(_rounded)]
"""Joint angles, radians."""


class ReachDocument(ApiModel):
    """Whether the arm can carry out a grasp, and with which joint angles.

    The arm moves to `q_pregrasp_rad` first. From there, a straight line of the flange leads to `q_grasp_rad`. On this
    line, no joint is beyond its limit, the posture is not singular, and arm, camera and gripper are free of collisions.
    """

    reachable: bool
    q_pregrasp_rad: Joints | None
    """Joint angles at the pre-grasp. Null if the grasp is not reachable."""
    q_grasp_rad: Joints | None
    """Joint angles at the grasp, in the same branch. Null if it is not reachable."""
    turned: bool
    """Whether the gripper is turned by pi about the approach direction. `T_base_flange` of this answer is then turned,
    too. The fingers close in the same way."""
    path_free: bool | None
    """Whether the straight line in joint space from `q_home_rad` to the pre-grasp is free of collisions. Null if the
    grasp is not reachable."""
    reason: ReachReason | None
    """Why the grasp is not reachable, or null."""
    message: str | None
    """The reason for people, or null."""


class ListedGrasp(GraspDocument):
    """A grasp of the model, with its reach."""

    reach: ReachDocument | None
    """Whether the arm can carry it out. Null if that was not determined."""

    @classmethod
    def of(cls, document: GraspDocument, reach: GraspReach | None, gripper: Gripper) -> "ListedGrasp":
        """Return a grasp with its reach. Its flange poses are those of the joint angles."""
        values = document.model_dump(by_alias=True)
        if reach is not None:
            grasp = document.to_grasp()
            poses = flange_poses(grasp.T_base_grasp[None], [grasp.reach_m], gripper)
            values["T_base_flange"] = _motion(poses.turned() if reach.turned else poses)
        document_of_reach = None if reach is None else ReachDocument.model_validate(reach, from_attributes=True)
        return cls.model_validate(values | {"reach": document_of_reach})


def _motion(poses: FlangePoses) -> GraspMotionDocument:
    return GraspMotionDocument.model_validate(GraspMotion(poses.pregrasp[0], poses.grasp[0], poses.retreat[0]))


class GraspsDocument(ApiModel):
    """The grasps of a model, without the rest of the model."""

    model_config = ConfigDict(extra="allow")

    schema_: Literal["pointchain/2"] = Field(alias="schema")
    frame: Literal["base"]
    total: int
    """Number of all grasps of the model."""
    same_calibration: bool | None
    """Whether the scan was made with the hand-eye calibration that is active now. Null if that is not known: the
    recording does not name its calibration, or no calibration is active."""
    same_gripper: bool
    """Whether the grasps are for the gripper that is configured now."""
    T_flange_tcp: Pose
    """Pose of the tool centre point on the flange: midway between the fingertips, x along the closing direction. It is
    that of the gripper for which the grasps are."""
    q_home_rad: Joints | None
    """Joint angles from which the reach was determined, those of the home posture. Null if it was not determined."""
    grasps: Sequence[ListedGrasp]
    """The grasps that the request asks for. First comes the best one of each cluster, then all others. Each part is
    sorted by score."""
