"""The views of a scan and the protocols of the devices that deliver them: live, simulated or recorded.

The kinds of devices are in `cell.control.equipment`.
"""

import time
from dataclasses import dataclass, field
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from calibration.geometry.transforms import rigid


class InvalidViewError(ValueError):
    """A value of a view is not valid, or two values contradict each other."""

    slug = "invalid-view"


@dataclass(frozen=True, eq=False)
class View:
    """One depth image with its camera pose, checked when it is created.

    Raises:
        InvalidViewError: The depth, an image or K has the wrong type or shape, or a value is not valid.
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
    """Depth image (H, W) along the optical axis in units of `depth_unit_m`; 0 = not measured."""
    depth_unit_m: float
    """Metres per depth count, from 1e-6 to 0.01."""
    K: NDArray[np.float64]
    """(3, 3) pinhole matrix of the rectified depth image, pixels, [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]."""
    T_base_flange: NDArray[np.float64]
    """(4, 4) flange pose, read while the arm was at rest, metres."""
    T_flange_camera: NDArray[np.float64]
    """(4, 4) hand-eye calibration, metres. The camera frame has x right, y down, z forward."""
    stamp_s: float = 0.0
    """Time of the last exposure, seconds since the epoch."""
    colour_jpeg: bytes | None = field(default=None, repr=False)
    """Colour image of the same moment, JPEG, or None."""
    image: NDArray[np.uint8] | None = field(default=None, repr=False)
    """Picture (H, W) or (H, W, 3) BGR for a calibration, with the size and K of the depth image, or None. Recordings do
    not contain it."""
    intensity: NDArray[np.uint8] | None = field(default=None, repr=False)
    """Grey image (H, W) of the exposures of the depth, of the same camera and aligned pixel for pixel, or None if the
    camera gives none."""

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
            raise InvalidViewError(f"{where}: depth unit {self.depth_unit_m!r} m; it must be from 1e-6 to 0.01")
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
        if self.image is not None:
            channels = (3,) if self.image.ndim == 3 else ()
            _require_grey_levels(self.image, (height, width, *channels), f"{where}: the picture")
        if self.intensity is not None:
            _require_grey_levels(self.intensity, (height, width), f"{where}: the intensity image")
        object.__setattr__(self, "K", K)
        object.__setattr__(self, "T_base_flange", rigid(self.T_base_flange, f"{where}: T_base_flange"))
        object.__setattr__(self, "T_flange_camera", rigid(self.T_flange_camera, f"{where}: T_flange_camera"))

    @property
    def T_base_camera(self) -> NDArray[np.float64]:
        """(4, 4) camera pose; maps camera points to the base frame."""
        return self.T_base_flange @ self.T_flange_camera


def _require_grey_levels(image: object, shape: tuple[int, ...], what: str) -> None:
    """Raise InvalidViewError unless an image is an array of uint8 of this shape."""
    if isinstance(image, np.ndarray) and image.dtype == np.uint8 and image.shape == shape:
        return
    found = f"{image.dtype} {image.shape}" if isinstance(image, np.ndarray) else type(image).__name__
    raise InvalidViewError(
        f"{what} is {found}; uint8 of {shape[1]}x{shape[0]} pixels is needed, the size of the depth image"
    )


@dataclass(frozen=True, eq=False)
class Frame:
    """Result of one capture: the median of several exposures at rest."""

    depth: NDArray[np.uint16]
    """Depth image (H, W) along the optical axis in units of `depth_unit_m`; 0 = not measured."""
    depth_unit_m: float
    """Metres per depth count."""
    K: NDArray[np.float64]
    """(3, 3) pinhole matrix of the depth image, pixels."""
    stamp_s: float
    """Start of the last exposure, seconds since the epoch."""
    exposures: int
    """Number of exposures that were combined."""
    colour_jpeg: bytes | None = field(default=None, repr=False)
    """Colour image of the same moment, JPEG, or None."""
    image: NDArray[np.uint8] | None = field(default=None, repr=False)
    """Picture (H, W) or (H, W, 3) BGR for a calibration, only on request: the mean of as many images at rest, without
    dots. It is rectified and of the camera of the depth image, so that `K` holds for it too."""
    intensity: NDArray[np.uint8] | None = field(default=None, repr=False)
    """Grey image (H, W) of the exposures of the depth, their mean, of the same camera and aligned pixel for pixel. None
    if the camera gives none, or if `image` was requested."""


@dataclass(frozen=True, eq=False)
class Burst:
    """Single exposures of the scene at rest, one after the other."""

    depth: NDArray[np.uint16]
    """Depth images (N, H, W) along the optical axis in units of `depth_unit_m`; 0 = not measured."""
    depth_unit_m: float
    """Metres per depth count."""
    began_s: NDArray[np.float64]
    """(N,) start of each exposure, seconds of `time.monotonic()`."""


@dataclass(frozen=True)
class ArmInfo:
    """Identity of a connected arm."""

    model: str
    """Model, as the controller names it."""
    serial: str
    """Serial number."""
    software: str
    """Version of the controller's software, for example 5.25.1."""


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
    """State of the arm at one moment, as its controller reports it."""

    q_rad: NDArray[np.float64]
    """Actual joint angles (6,)."""
    qd_rad_s: NDArray[np.float64]
    """Actual joint speeds (6,)."""
    T_base_flange: NDArray[np.float64]
    """(4, 4) actual flange pose by the controller's own calibrated kinematics."""
    robot_mode: RobotMode
    """Robot mode of the controller."""
    safety_mode: SafetyMode
    """Safety mode of the controller."""
    moving: bool
    """Whether a move of this program runs, or the joints still turn."""
    controller_s: float
    """Clock of the controller, seconds since its start."""
    age_s: float
    """Age of the controller's last new data when it was read."""
    read_s: float = field(default_factory=time.monotonic)
    """Time of reading, seconds of `time.monotonic()`."""


@dataclass(frozen=True)
class CameraInfo:
    """Identity and condition of a connected camera."""

    product: str
    """Product name."""
    device_id: str
    """Device id."""
    width: int
    """Width of the depth image, pixels."""
    height: int
    """Height of the depth image, pixels."""
    connection: str
    """Kind of the link, for example "USB 3 (SUPER)", "USB 2 (HIGH)", "TCP" or "simulated"."""
    temperature_c: float | None
    """Temperature of the chip, degrees Celsius, or None without a sensor."""
    warnings: tuple[str, ...]
    """What an operator should know, for example a slow USB link or intrinsics that differ from the factory's."""
    depth_unit_m: float = 0.0001
    """Metres per depth count, the same as in each frame."""
    has_images: bool = True
    """Whether frames can have an intensity image, which a calibration needs."""


class Arm(Protocol):
    """The arm of a scan. Every method but `stop` belongs to one thread; `stop` may be called from any."""

    def connect(self) -> ArmInfo:
        """Connect to the arm so that it can be moved. The arm does not move.

        Raises:
            RobotUnreachableError: No controller answers.
            RobotNotReadyError: The controller cannot be driven now, for example because of another program.
            RobotLostError: The link broke.
            ProtectiveStopError: The robot is in a protective stop.
            EmergencyStopError: The robot is in an emergency stop.
            StoppedError: `stop` was called meanwhile.
        """
        ...

    def state(self) -> ArmState:
        """Return the arm's present state.

        Raises:
            RobotLostError: The link broke.
        """
        ...

    def move(self, q_rad: NDArray[np.float64]) -> ArmState:
        """Move to the joint angles (6,) and return the state at rest there.

        Raises:
            RobotLostError: The link broke.
            RobotNotReadyError: Another program has taken the arm.
            ProtectiveStopError: The robot is in a protective stop.
            EmergencyStopError: The robot is in an emergency stop.
            MotionError: The controller rejects the angles, or the arm does not reach them.
            StoppedError: `stop` was called.
        """
        ...

    def stop(self) -> None:
        """Stop the arm. The stop is sent when this returns.

        A move raises StoppedError then, and so does every later move until `connect`.
        """
        ...

    def acknowledge(self) -> None:
        """End the program and unlock a protective stop, after a person has inspected the cell. The arm does not move.

        Raises:
            TooEarlyError: The robot cannot be unlocked yet.
            RobotNotReadyError: The robot does not unlock.
            ProtectiveStopError: The robot is still in a protective stop.
            EmergencyStopError: The robot is in an emergency stop.
            RobotUnreachableError: No controller answers.
        """
        ...

    def close(self) -> None:
        """Release the arm. An arm that moves is stopped first."""
        ...


class DrivenArm(Arm, Protocol):
    """An arm with what the cell needs between scans."""

    @property
    def host(self) -> str:
        """Address of the controller."""
        ...

    @property
    def latest(self) -> ArmState | None:
        """Last state that the arm reported, or None. Nothing is queried. It may be read from any thread."""
        ...

    def check_ready(self) -> None:
        """Return if the arm can be moved now. Raise the errors of `Arm.move` otherwise; the connection is then over."""
        ...


class Camera(Protocol):
    """The depth camera of a scan, for use by one thread."""

    def connect(self) -> CameraInfo:
        """Open the camera and wait for its first frame.

        Raises:
            CameraUnreachableError: No camera answers.
        """
        ...

    def capture(self, after_s: float, with_image: bool = False) -> Frame:
        """Capture the scene at rest.

        Args:
            after_s: Earliest start of an exposure, seconds of `time.monotonic()`.
            with_image: Whether the frame has an `image` for a calibration, in place of `intensity`.

        Raises:
            CameraLostError: The camera is lost.
            BadFrameError: The images show nothing, or none came.
        """
        ...

    def info(self) -> CameraInfo:
        """Return the camera's present state.

        Raises:
            CameraLostError: The camera does not answer.
        """
        ...

    def close(self) -> None:
        """Release the camera."""
        ...
