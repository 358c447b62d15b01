"""The cell's devices and what they deliver, whether live, simulated or recorded."""

import time
from dataclasses import dataclass, field
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from calibration.geometry.transforms import rigid


class InvalidViewError(ValueError):
    """The parts of a view are not valid, or do not fit together."""

    slug = "invalid-view"


@dataclass(frozen=True, eq=False)
class View:
    """One depth image with its camera pose. The values are checked when the view is made.

    Raises:
        InvalidViewError: The depth, the picture or K has the wrong type or shape, or a value is not valid.
        NotRigidError: A pose is not a rigid transform.

    Example:
        >>> import numpy as np
        >>> from calibration.geometry import from_rotation_vector
        >>> view = View(
        ...     index=0,
        ...     depth=np.full((400, 640), 500, dtype=np.uint16),
        ...     depth_unit_m=0.001,
        ...     K=np.array([[400.0, 0.0, 319.5], [0.0, 400.0, 199.5], [0.0, 0.0, 1.0]]),
        ...     T_base_flange=from_rotation_vector((0.4, 0.0, 0.5), (np.pi, 0.0, 0.0)),
        ...     T_flange_camera=from_rotation_vector((0.0, 0.0, 0.05), (0.0, 0.0, 0.0)),
        ... )
        >>> np.abs(view.T_base_camera[:3, 3]).round(3).tolist()
        [0.4, 0.0, 0.45]
    """

    index: int
    """Number of the viewpoint, from 0."""
    depth: NDArray[np.uint16]
    """(H, W) depth along the optical axis in units of `depth_unit_m`; 0 = not measured."""
    depth_unit_m: float
    """Metres per depth count, from 1e-6 to 0.01."""
    K: NDArray[np.float64]
    """(3, 3) pinhole matrix of the rectified depth image, pixels, [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]."""
    T_base_flange: NDArray[np.float64]
    """(4, 4) flange pose, read while the arm was at rest, metres."""
    T_flange_camera: NDArray[np.float64]
    """(4, 4) hand-eye calibration, metres. The camera frame has x right, y down, z forward."""
    stamp_s: float = 0.0
    """Time of the exposure, seconds since the epoch."""
    colour_jpeg: bytes | None = field(default=None, repr=False)
    """Colour image of the same moment, JPEG, or None."""
    image: NDArray[np.uint8] | None = field(default=None, repr=False)
    """(H, W) or (H, W, 3) BGR picture of the camera of the depth image, with the same size and K, or None. It is not
    part of a recording."""

    def __post_init__(self) -> None:
        where = f"view {self.index}"
        if not isinstance(self.depth, np.ndarray) or self.depth.dtype != np.uint16 or self.depth.ndim != 2:
            what = (
                f"{self.depth.dtype} {self.depth.shape}"
                if isinstance(self.depth, np.ndarray)
                else type(self.depth).__name__
            )
            raise InvalidViewError(f"{where}: depth is {what}; a (H, W) array of uint16 is needed")
        if self.depth.size == 0:
            raise InvalidViewError(f"{where}: the depth image is empty")
        if not (np.isfinite(self.depth_unit_m) and 1e-6 <= self.depth_unit_m <= 0.01):
            raise InvalidViewError(f"{where}: depth unit {self.depth_unit_m!r} m; from 1e-6 to 0.01 is taken")
        K = np.asarray(self.K, dtype=np.float64)
        if K.shape != (3, 3) or not np.isfinite(K).all():
            raise InvalidViewError(f"{where}: K must be a finite 3x3 matrix, got {K.tolist()}")
        height, width = self.depth.shape
        fx, fy, cx, cy = K[0, 0], K[1, 1], K[0, 2], K[1, 2]
        if not (fx > 0 and fy > 0):
            raise InvalidViewError(f"{where}: K has focal lengths {fx:g}, {fy:g}; not a camera's")
        if not np.array_equal(K, [(fx, 0, cx), (0, fy, cy), (0, 0, 1)]):
            raise InvalidViewError(f"{where}: K is {K.tolist()}; [[fx, 0, cx], [0, fy, cy], [0, 0, 1]] is needed")
        if not (0 < cx < width and 0 < cy < height):
            raise InvalidViewError(
                f"{where}: K has its centre at ({cx:g}, {cy:g}), outside the {width}x{height} depth image: "
                "the calibration is of another resolution"
            )
        if self.image is not None and not (
            self.image.dtype == np.uint8 and self.image.shape in ((height, width), (height, width, 3))
        ):
            raise InvalidViewError(
                f"{where}: the picture is {self.image.dtype} {self.image.shape}; uint8 of {width}x{height} is needed"
            )
        object.__setattr__(self, "K", K)
        object.__setattr__(self, "T_base_flange", rigid(self.T_base_flange, f"{where}: T_base_flange"))
        object.__setattr__(self, "T_flange_camera", rigid(self.T_flange_camera, f"{where}: T_flange_camera"))

    @property
    def T_base_camera(self) -> NDArray[np.float64]:
        """(4, 4) camera pose; maps camera points to the base frame."""
        return self.T_base_flange @ self.T_flange_camera


@dataclass(frozen=True, eq=False)
class Frame:
    """What a camera gives for one look: the median of several exposures taken at rest."""

    depth: NDArray[np.uint16]
    """(H, W), in units of `depth_unit_m` along the optical axis; 0 = not measured."""
    depth_unit_m: float
    """Metres per depth count."""
    K: NDArray[np.float64]
    """(3, 3) pinhole matrix of the depth image, pixels."""
    stamp_s: float
    """When the last exposure began, seconds since the epoch."""
    exposures: int
    """How many were combined."""
    colour_jpeg: bytes | None = field(default=None, repr=False)
    image: NDArray[np.uint8] | None = field(default=None, repr=False)
    """(H, W) or (H, W, 3) BGR, only where it was asked for: the mean of as many pictures, taken at rest by the camera
    that the depth image is of; rectified, so that `K` holds for it too and there is no distortion."""


@dataclass(frozen=True)
class ArmInfo:
    """Which arm answered."""

    model: str
    """As the controller names it."""
    serial: str
    software: str
    """The controller's version, as 5.25.1."""


RobotMode = Literal[
    "no_controller", "disconnected", "confirm_safety", "booting", "power_off", "power_on", "idle", "backdrive",
    "running", "updating_firmware",
]  # fmt: skip
SafetyMode = Literal[
    "normal", "reduced", "protective_stop", "recovery", "safeguard_stop", "system_emergency_stop",
    "robot_emergency_stop", "violation", "fault", "validate_joint_id", "undefined",
]  # fmt: skip


@dataclass(frozen=True, eq=False)
class ArmState:
    """The arm at one moment, as its controller tells it."""

    q_rad: NDArray[np.float64]
    """(6,) actual joint angles."""
    qd_rad_s: NDArray[np.float64]
    """(6,) actual joint speeds."""
    T_base_flange: NDArray[np.float64]
    """(4, 4) actual flange pose by the controller's own calibrated kinematics."""
    robot_mode: RobotMode
    safety_mode: SafetyMode
    moving: bool
    """A move of ours is under way, or the joints still turn."""
    controller_s: float
    """The controller's clock, seconds since its start."""
    age_s: float
    """How long ago the controller had last sent anything new when this was read."""
    read_s: float = field(default_factory=time.monotonic)
    """When that was, `time.monotonic()`."""


@dataclass(frozen=True)
class CameraInfo:
    """Which camera answered, and how it is."""

    product: str
    device_id: str
    width: int
    """Of its depth image, pixels."""
    height: int
    connection: str
    """As "USB 3 (SUPER)", "USB 2 (HIGH)", "TCP", "simulated"."""
    temperature_c: float | None
    """Of its chip; None where it has no sensor."""
    warnings: tuple[str, ...]
    """What an operator should know: a slow USB link, intrinsics that differ from the factory's ..."""


class Arm(Protocol):
    """What a scan needs of an arm. Every method but `stop` belongs to one thread; `stop` to any."""

    def connect(self) -> ArmInfo:
        """Takes the arm: after this it can be moved. It does not move.

        Raises: RobotUnreachableError, RobotNotReadyError, RobotLostError, ProtectiveStopError, EmergencyStopError;
        StoppedError when `stop` was called meanwhile.
        """
        ...

    def state(self) -> ArmState:
        """The arm now. Raises RobotLostError."""
        ...

    def move(self, q_rad: NDArray[np.float64]) -> ArmState:
        """Moves to the joint angles (6,) and returns the state at rest there.

        Raises: RobotLostError, ProtectiveStopError, EmergencyStopError, RobotNotReadyError, MotionError,
        StoppedError (after `stop`).
        """
        ...

    def stop(self) -> None:
        """Stops the arm at once: sent when this returns. A move under way raises StoppedError, and so does every later
        one until `connect`."""
        ...

    def acknowledge(self) -> None:
        """A person has looked at the cell after a fault: ends the program and unlocks a protective stop. No motion.

        Raises: TooEarlyError, RobotNotReadyError, ProtectiveStopError, EmergencyStopError, RobotUnreachableError.
        """
        ...

    def close(self) -> None:
        """Lets the arm go. A move under way is stopped first."""
        ...


class Camera(Protocol):
    """What a scan needs of a depth camera; for use by one thread."""

    def connect(self) -> CameraInfo:
        """Opens the camera and waits for its first frame. Raises CameraUnreachableError."""
        ...

    def capture(self, after_s: float, image: bool = False) -> Frame:
        """The scene at rest: only exposures that began after `after_s` (seconds of `time.monotonic()`).

        With `image` the frame has a picture too; without, none is made or sent.

        Raises: CameraLostError, BadFrameError.
        """
        ...

    def info(self) -> CameraInfo:
        """The camera now. Raises CameraLostError."""
        ...

    def close(self) -> None:
        """Lets the camera go."""
        ...
