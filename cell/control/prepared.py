"""What `Cell.prepare_scan` and its siblings find out, as values that `Cell.run` takes."""

from dataclasses import dataclass
from typing import ClassVar, Literal

from calibration.storage.hand_eye_file import HandEye
from calibration.target.board import Board
from cell.planning.expected_duration import ExpectedDuration
from cell.planning.viewpoints import ViewpointPlan
from cell.recording.header import RecordingHeader

Purpose = Literal["scan", "calibration", "verification"]


@dataclass(frozen=True, eq=False)
class PreparedScan:
    """A scan that the cell can run now."""

    purpose: ClassVar[Purpose] = "scan"
    plan: ViewpointPlan
    """Viewpoints and the joint path through them."""
    hand_eye: HandEye
    """Active calibration. Each view gets its `T_flange_camera`."""
    requested_at: float
    """Time of the request, monotonic seconds. A later stop cancels the scan."""
    min_views: int
    """Minimum number of views. With fewer views the scan fails."""
    header: RecordingHeader
    """Header of the recording, without a string radius."""
    connect_s: float
    """Time that connecting arm and camera took, seconds. Nearly 0 if they were connected."""
    plan_s: float
    """Time that planning the viewpoints took, seconds."""
    expected: ExpectedDuration
    """How long the scan is expected to take from its first move on, with as few views as may do."""
    expected_with_all: ExpectedDuration
    """How long the scan takes from its first move on if all viewpoints are visited."""
    may_end_after: int | None = None
    """Number of views after which the scan may end early. None: all viewpoints are visited."""


@dataclass(frozen=True, eq=False)
class PreparedCalibration:
    """A calibration that the cell can run now."""

    purpose: ClassVar[Purpose] = "calibration"
    plan: ViewpointPlan
    """Camera poses and the joint path through them. `plan.held_out` lists the poses for the verification."""
    hand_eye: HandEye
    """Initial guess of the calibration, with which the poses were planned."""
    requested_at: float
    """Time of the request, monotonic seconds. A later stop cancels the calibration."""
    min_views: int
    """Minimum number of views. With fewer views the calibration fails."""
    board: Board
    """Board on the table."""
    camera_id: str
    """Device id of the camera."""
    robot_serial: str
    """Serial number of the robot."""


@dataclass(frozen=True, eq=False)
class PreparedVerification:
    """A verification of the active calibration that the cell can run now."""

    purpose: ClassVar[Purpose] = "verification"
    plan: ViewpointPlan
    """Camera poses and the joint path through them."""
    hand_eye: HandEye
    """Active calibration, which is to be verified."""
    requested_at: float
    """Time of the request, monotonic seconds. A later stop cancels the verification."""
    min_views: int
    """Minimum number of views, which is the number of poses."""
    board: Board
    """Board of the calibration."""
    camera_id: str
    """Device id of the camera."""
    robot_serial: str
    """Serial number of the robot."""


Prepared = PreparedScan | PreparedCalibration | PreparedVerification
"""What `Cell.run` takes."""
