"""The list of the grasps of a scan, and the height map of the table. Metres and radians, base frame."""

from dataclasses import dataclass

from pointchain_client.documents.decoding import Heights, Joints, Pose
from pointchain_client.documents.model import Grasp


@dataclass(frozen=True, eq=False)
class GraspList:
    """Grasps of a scan that meet the conditions of a request, with their reach."""

    schema: str
    """Name and version of the model's document."""
    frame: str
    """Frame of all poses, `base`."""
    total: int
    """Number of grasps of the model."""
    T_flange_tcp: Pose
    """(4, 4) pose of the tool centre point on the flange. It is midway between the ends of the fingertips, with z out
    of the gripper and x along the closing direction."""
    q_home_rad: Joints | None
    """(6,) joint angles of the posture from which the reach is determined, radians. None if no reach was determined."""
    grasps: tuple[Grasp, ...]
    """The grasps in the order of the model, first the best of each cluster, then all others."""
    same_calibration: bool | None
    """Whether the scan was made with the hand-eye calibration that is active now. None if that is not known."""
    same_gripper: bool
    """Whether the grasps are for the gripper that is configured now."""

    @property
    def no_reach_reason(self) -> str | None:
        """Why no reach was determined, and what to do. None if it was determined."""
        if self.q_home_rad is not None:
            return None
        if not self.same_gripper:
            return "the gripper in the configuration has changed since; recognise the scan again"
        if self.same_calibration is False:
            return "the calibration has changed since; scan again"
        if self.same_calibration and self.same_gripper:
            return "the request left the reach out"
        return "the scan is a recording that names no calibration, or no calibration can be used; scan again"

    @property
    def reachable(self) -> tuple[Grasp, ...]:
        """The grasps that the arm can carry out, in the same order."""
        return tuple(grasp for grasp in self.grasps if grasp.reach is not None and grasp.reach.reachable)


@dataclass(frozen=True, eq=False)
class HeightMap:
    """Height of the table and of all that lies on it, in square cells, as the median of the views."""

    frame: str
    """Frame of all positions and heights, `base`."""
    x_m: float
    """Position of the first edge of the first cell along x, metres."""
    y_m: float
    """The same along y, metres."""
    cell_m: float
    """Edge length of the cells, metres. Cell (i, j) begins at `x_m + i * cell_m`, `y_m + j * cell_m`."""
    table_z_m: float
    """Height of the table plane, metres."""
    min_object_height_m: float
    """Minimum height above the table of an object that is not noise, metres."""
    z_m: Heights
    """(M, N) height in each of M cells along x and N cells along y, metres. NaN where no view measured it."""
