"""The cell: arm, camera, calibration and viewpoints, as they last reported, and what a scan would use.

Metres, radians, base frame.
"""

from dataclasses import dataclass

from pointchain_client.documents.decoding import Pose, Values


@dataclass(frozen=True, eq=False)
class Robot:
    """The last state that the controller of the arm reported."""

    kind: str
    """`simulated` or `ur`."""
    model: str
    """Model of the arm, for example `ur5e`."""
    serial: str | None
    """Serial number. None until the arm was connected."""
    software: str | None
    """Version of the controller's software."""
    robot_mode: str | None
    """Mode of the arm, for example `running`. None if it is unknown."""
    safety_mode: str | None
    """Safety mode, for example `normal`. None if it is unknown."""
    moving: bool | None
    """Whether the arm moves. None if it is unknown."""
    q_rad: Values | None
    """(6,) joint angles, radians."""
    T_base_flange: Pose | None
    """(4, 4) pose of the flange in the base frame, metres."""
    at_home: bool | None
    """Whether the arm stood in its home posture when its state was last read. None until viewpoints were planned."""
    age_s: float | None
    """Age of this state, seconds."""


@dataclass(frozen=True)
class Camera:
    """The camera, as it last reported."""

    kind: str
    """`simulated` or `oak`."""
    product: str | None
    """Name of the product. None until the camera was connected."""
    device_id: str | None
    """Id of the device."""
    width: int | None
    """Width of the depth image, pixels."""
    height: int | None
    """Height of the depth image, pixels."""
    connection: str | None
    """Kind of the connection, for example of USB."""
    temperature_c: float | None
    """Temperature, degrees Celsius."""
    warnings: tuple[str, ...]
    """Warnings for people."""


@dataclass(frozen=True, eq=False)
class CalibrationSummary:
    """The hand-eye calibration in use."""

    T_flange_camera: Pose
    """(4, 4) pose of the camera in the flange frame, metres."""
    created_at: str | None
    """Time of the measurement, RFC 3339. None if it is not known."""
    camera_id: str | None
    """Id of the camera."""
    robot_serial: str | None
    """Serial number of the arm."""
    sha256: str
    """SHA-256 of the calibration."""
    warnings: tuple[str, ...]
    """Warnings for people."""


@dataclass(frozen=True)
class UnreachableViewpoint:
    """A viewpoint that the arm cannot reach."""

    index: int
    """Number of the viewpoint."""
    reason: str
    """Description for people."""


@dataclass(frozen=True)
class Viewpoints:
    """Summary of the last plan of viewpoints."""

    planned: int
    """Number of planned viewpoints."""
    reachable: int
    """Number of viewpoints that the arm can reach."""
    unreachable: tuple[UnreachableViewpoint, ...]
    """The other viewpoints."""
    warning: str | None
    """The part of the workspace that the reachable viewpoints do not show well. None if there is no such part."""


@dataclass(frozen=True)
class ScanValidation:
    """What a scan would use. No scan was started, and no device was contacted."""

    valid: bool
    """Whether the request is valid. It always is, because another request raises `ProblemError`."""
    mode: str
    """`live` or `replay`."""
    recording: str | None
    """Id of the recording. None for a live scan."""
    method: str
    """Recognition method."""
    string_radius_m: float | None
    """Radius that recognition would use, metres. None if it would be measured."""
    all_grasps: bool
    """Whether the model would also have the grasps on parts of strings with a doubt."""
    viewpoints: Viewpoints | None
    """Viewpoints of a live scan, planned from the last known posture of the arm. None for a replay."""


@dataclass(frozen=True)
class CellWarning:
    """A condition that does not prevent scans but needs attention."""

    code: str
    """Code for programs, for example `calibration-drift`."""
    message: str
    """Description for people, with what to do."""


@dataclass(frozen=True)
class Intervention:
    """A stop of the arm, or the acknowledgement of a fault."""

    at: str
    """Time, RFC 3339."""
    by: str | None
    """Name of the caller. None if it needs no token, and for a stop by the service itself."""


@dataclass(frozen=True, eq=False)
class Cell:
    """The last known state of the cell. Reading it contacts no device."""

    state: str
    """`not_ready`, `ready`, `busy` or `fault`. In a fault, a person must inspect the cell and acknowledge."""
    problem: str | None
    """Type of the problem that keeps the cell from being ready. None without such a problem.

    For example `urn:pointchain:released`.
    """
    reason: str | None
    """The same as a message for people, with what to do."""
    simulated: bool
    """Whether the arm or the camera is simulated."""
    robot: Robot
    """The arm."""
    camera: Camera
    """The camera."""
    calibration: CalibrationSummary | None
    """The hand-eye calibration in use. None until a calibration was loaded."""
    viewpoints: Viewpoints | None
    """The last plan of viewpoints. None until viewpoints were planned."""
    warnings: tuple[CellWarning, ...]
    """Conditions that need attention, for example a drift of the camera from its calibration."""
    last_stop: Intervention | None
    """The last stop of the arm since the service started."""
    last_acknowledgement: Intervention | None
    """The last acknowledgement of a fault since the service started."""
