"""Box model of a parallel gripper, and the distance of points from the gripper during the approach."""

import math
from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray

from recognition.errors import InvalidGripperError

MAX_DIMENSION_M = 0.5
"""Maximum dimension of a gripper, metres. A larger value was probably given in millimetres."""


Corner = tuple[float, float, float]
"""A point (x, y, z), metres."""


@dataclass(frozen=True)
class GripperBox:
    """A box of the gripper's body, metres.

    Its frame has its origin in the middle of the flange, x along the closing direction of the fingers and z out of the
    flange.
    """

    low_m: Corner
    """Corner with the smallest coordinates."""
    high_m: Corner
    """Corner with the largest coordinates."""


@dataclass(frozen=True)
class Gripper:
    """Dimensions of a parallel gripper, metres.

    In the gripper frame, x is the closing direction, and z points from the palm to the fingertips. The default values
    describe a common two-finger gripper with a stroke of 85 mm and slim fingertips. Its length is that of a Robotiq
    2F-85.

    Raises:
        InvalidGripperError: A dimension is not valid.
    """

    finger_width_m: float = 0.010
    """Width of each finger along the string (y)."""
    finger_thickness_m: float = 0.005
    """Thickness of each finger in the closing direction (x)."""
    finger_depth_m: float = 0.040
    """Length of the fingers from the palm to the fingertips (z)."""
    stroke_m: float = 0.085
    """Maximum opening between the fingers."""
    palm_width_m: float = 0.075
    """Width of the palm along the string (y). Across the string, its width is `stroke_m` plus twice
    `finger_thickness_m`."""
    opening_margin_m: float = 0.004
    """Extra opening before the fingers close, in addition to the space that the string needs. Sum of both sides."""
    clearance_m: float = 0.001
    """Minimum distance of fingers and palm from everything that is not gripped, except the table."""
    table_clearance_m: float = 0.002
    """Distance of the fingertips from the table, or from an object that lies under the string. At a thin string, the
    fingertips come closer, so that they still reach beyond its centre line."""
    min_table_clearance_m: float = 0.00075
    """Minimum distance of the fingertips from the table, or from an object that lies under the string. A smaller
    `table_clearance_m` replaces it."""
    length_m: float = 0.174
    """Distance from the flange to the fingertips, with adapters, at the opening of a grasp (z)."""
    mounting_rotation_rad: float = 0.0
    """Rotation of the gripper on the flange, from the flange's x axis to the closing direction, about z."""
    body_m: tuple[GripperBox, ...] = ()
    """Boxes between flange and fingers. Without a box, the palm reaches up to the flange."""

    @property
    def half_span_m(self) -> float:
        """Distance of the outer side of a finger from the middle at the largest opening, which the palm has too."""
        return self.stroke_m / 2 + self.finger_thickness_m

    @property
    def body(self) -> tuple[GripperBox, ...]:
        """Boxes between flange and fingers, which are the given ones or the palm up to the flange."""
        if self.body_m:
            return self.body_m
        x = self.half_span_m
        y = self.palm_width_m / 2
        return (GripperBox((-x, -y, 0.0), (x, y, self.length_m - self.finger_depth_m)),)

    @property
    def fingers(self) -> GripperBox:
        """The box that contains both fingers at the largest opening, in the same frame."""
        x = self.half_span_m
        y = self.finger_width_m / 2
        return GripperBox((-x, -y, self.length_m - self.finger_depth_m), (x, y, self.length_m))

    def __post_init__(self) -> None:
        may_be_zero = ("opening_margin_m", "clearance_m", "table_clearance_m", "min_table_clearance_m")
        for name, value in asdict(self).items():
            if name in ("mounting_rotation_rad", "body_m"):
                continue
            if isinstance(value, bool) or not (isinstance(value, float | int) and math.isfinite(value)):
                raise InvalidGripperError(f"{name} is {value!r}; a length in metres is needed")
            if value < 0 or (value == 0 and name not in may_be_zero):
                raise InvalidGripperError(f"{name} is {value:g} m; it must be positive")
            if value > MAX_DIMENSION_M:
                raise InvalidGripperError(
                    f"{name} is {value:g} m; the maximum is {MAX_DIMENSION_M:g} m (give metres, not mm)"
                )
        if self.length_m <= self.finger_depth_m:
            raise InvalidGripperError(
                f"length_m is {self.length_m:g} m; it must be more than finger_depth_m, {self.finger_depth_m:g} m"
            )
        turn = self.mounting_rotation_rad
        if isinstance(turn, bool) or not (isinstance(turn, float | int) and abs(turn) <= 2 * math.pi):
            raise InvalidGripperError(f"mounting_rotation_rad is {turn!r}; an angle from -2 pi to 2 pi is needed")
        for number, box in enumerate(self.body_m, 1):
            _check_box(number, box)


def _check_box(number: int, box: GripperBox) -> None:
    """Raise InvalidGripperError if the box is empty, or larger than a gripper."""
    for axis, low, high in zip("xyz", box.low_m, box.high_m, strict=True):
        if not (math.isfinite(low) and math.isfinite(high) and low < high):
            raise InvalidGripperError(
                f"body_m: box {number} reaches from {axis} = {low:g} to {high:g} m; the first must be less"
            )
        if max(abs(low), abs(high)) > MAX_DIMENSION_M:
            raise InvalidGripperError(
                f"body_m: box {number} is farther than {MAX_DIMENSION_M:g} m from the flange (give metres, not mm)"
            )


def swept_distance(
    points: NDArray[np.float64],
    opening_m: NDArray[np.float64],
    reach_m: NDArray[np.float64],
    gripper: Gripper,
    closing: NDArray[np.bool_],
) -> NDArray[np.float64]:
    """Return the distances of points from the volume that the gripper sweeps on its approach to a grasp.

    The volume consists of boxes for the two fingers and the palm. The boxes extend infinitely against the approach
    direction.

    Args:
        points: (N, 3) points, metres. Each point is in the frame of its grasp: z along the approach, origin on the
            centre line.
        opening_m: (N,) opening between the fingers, metres.
        reach_m: (N,) distance of the fingertips beyond the origin, metres.
        gripper: Dimensions of the gripper.
        closing: Mask (N,), True where the space between the fingers belongs to the volume. Set True for points that
            must not be gripped.

    Returns:
        (N,) distances, metres; 0 inside the volume.
    """
    x = np.abs(points[:, 0])
    y = np.abs(points[:, 1])
    z = points[:, 2]
    inner = np.where(closing, 0.0, opening_m / 2)
    outer = opening_m / 2 + gripper.finger_thickness_m
    fingers = _box_distance(np.maximum(inner - x, x - outer), y - gripper.finger_width_m / 2, z - reach_m)
    palm = _box_distance(x - gripper.half_span_m, y - gripper.palm_width_m / 2, z - (reach_m - gripper.finger_depth_m))
    return np.minimum(fingers, palm)


def _box_distance(*outside: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the distances (N,) of points from a box.

    Each argument (N,) is the distance of the points from the box along one axis; a negative value is inside.
    """
    return np.sqrt(sum(np.maximum(part, 0.0) ** 2 for part in outside))
