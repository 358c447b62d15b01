"""Where the table is, measured in all views: what of its plane the errors of the poses do not explain.

A real table is at the same place in all views. An error of the hand-eye calibration moves it in directions that turn
with the camera, and an error of the robot moves it in one view. Each view therefore gives a linear equation for the
table, the shared errors and its own errors, and least squares with the prior of these errors separates them.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.geometry.se3 import cross_matrix
from calibration.geometry.transforms import from_rotation_vector, transform_points
from recognition.errors import TableElsewhereError
from recognition.preprocessing.table_measurement import ViewPlane
from recognition.preprocessing.target_cloud import DepthView, intensity_of
from recognition.registration.pose_prior import N_SHARED, PoseSigmas, disparity_axes

MAX_SIGMA = 4.3
"""Maximum Mahalanobis norm of the offset (height and two tilts) that errors of the poses explain. A table that is where
it is given exceeds the limit in one of three thousand scans, as in `registration.MAX_HAND_EYE_ERROR_SIGMA`."""
MAX_HEIGHT_M = 0.02
"""Maximum distance of the table from its given height for which a model is made, metres. A plane that is farther away
may be another surface, for example a lid or the floor."""
MAX_TILT_RAD = float(np.deg2rad(4))
"""Maximum tilt of the table for which a model is made, radians. It is also a limit for what a person overlooks."""
MAX_NEAR_M = 0.001
"""Maximum distance of two planes in the middle of a view for which the views are not preprocessed again, metres. Each
view is aligned to the table plane in any case."""
MAX_NEAR_RAD = 0.005
"""Maximum angle of two planes for which the views are not preprocessed again, radians."""
MEDIAN_CHI2 = 2.37
"""Median of the squared Mahalanobis norm of three Gaussian errors."""
MIN_SLOPE = 1e-12
"""Lower limit of the slope by which the tilt is divided. It keeps the rotation of a level plane finite."""


@dataclass(frozen=True, eq=False)
class MeasuredTable:
    """Plane of the table that the views agree on, relative to the given plane."""

    centre: NDArray[np.float64]
    """(3,) point of the given plane in the middle of the measured points, metres, base frame."""
    offset: NDArray[np.float64]
    """(3,) slope of the measured plane along y, negative slope along x (its small rotation about x and y), and height
    above the given plane at the centre, metres."""
    covariance: NDArray[np.float64]
    """(3, 3) covariance of the offset, with the errors that all views share."""

    @property
    def height_m(self) -> float:
        """Height of the measured plane above the given one at the centre, metres."""
        return float(self.offset[2])

    @property
    def tilt_rad(self) -> float:
        """Angle between the measured and the given plane, radians."""
        return float(np.arctan(np.hypot(self.offset[0], self.offset[1])))

    @property
    def distance_sigma(self) -> float:
        """Mahalanobis norm of the offset."""
        return float(np.sqrt(self.offset @ np.linalg.solve(self.covariance, self.offset)))

    @property
    def is_elsewhere(self) -> bool:
        """Whether errors of the poses do not explain the offset."""
        return self.distance_sigma > MAX_SIGMA

    @property
    def T_base_table(self) -> NDArray[np.float64]:
        """(4, 4) motion of the given plane to the measured one, base to base, metres."""
        slope_y, minus_slope_x, height_m = self.offset
        slope = max(float(np.hypot(slope_y, minus_slope_x)), MIN_SLOPE)
        T = from_rotation_vector((0, 0, 0), np.array([slope_y, minus_slope_x, 0.0]) * self.tilt_rad / slope)
        T[:3, 3] = self.centre + (0.0, 0.0, height_m) - T[:3, :3] @ self.centre
        return T

    def pose_covariance(self, covariance: NDArray[np.float64], centre: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the covariance (6, 6) of the motion of all views that an error of the table causes.

        Args:
            covariance: (3, 3) covariance of the error, as that of the offset.
            centre: (3,) point about which the motion rotates, metres, base frame. The motion is a rotation (rad), then
                a translation (m).
        """
        J = np.zeros((6, 3))
        J[0, 0] = J[1, 1] = J[5, 2] = 1.0
        J[5, :2] = -cross_matrix(centre - self.centre)[2, :2]
        return J @ covariance @ J.T


@dataclass(frozen=True, eq=False)
class MovedView:
    """View with another camera pose."""

    image: DepthView
    """View whose image is used."""
    T_base_camera: NDArray[np.float64]
    """(4, 4) camera pose, metres."""

    @property
    def index(self) -> int:
        """Number of the view."""
        return self.image.index

    @property
    def depth(self) -> NDArray[np.uint16]:
        """(H, W) depth image."""
        return self.image.depth

    @property
    def depth_unit_m(self) -> float:
        """Metres per depth count."""
        return self.image.depth_unit_m

    @property
    def K(self) -> NDArray[np.float64]:
        """(3, 3) pinhole matrix, pixels."""
        return self.image.K

    @property
    def intensity(self) -> NDArray[np.uint8] | None:
        """(H, W) intensity image, or None."""
        return intensity_of(self.image)


def locate_table(
    planes: Sequence[ViewPlane], table_z_m: float, sigmas: PoseSigmas | None = None
) -> MeasuredTable | None:
    """Return the plane of the table that the views agree on.

    Views whose plane does not fit the others are excluded, as long as a majority remains. If the remaining planes
    scatter more than the sigmas allow, the covariance grows in proportion.

    Args:
        planes: Plane of the table in each view that shows it.
        table_z_m: Given height of the table, metres, base frame.
        sigmas: Standard deviations of the pose errors. None: the defaults of `PoseSigmas`.

    Returns:
        The measured table; None if no view shows it.
    """
    if len(planes) == 0:
        return None
    sigmas = sigmas or PoseSigmas()
    centre = np.append(np.median([plane.centre[:2] for plane in planes], axis=0), table_z_m)
    G, y = _equations(planes, centre, sigmas)
    min_views = len(planes) // 2 + 1
    prior = np.zeros((3 + N_SHARED, 3 + N_SHARED))
    prior[3:, 3:] = sigmas.shared_information
    while True:
        stacked = G.reshape(-1, 3 + N_SHARED)
        information = prior + stacked.T @ stacked
        state = np.asarray(np.linalg.solve(information, stacked.T @ y.ravel()), dtype=np.float64)
        squares = np.sum((y - G @ state) ** 2, axis=1)
        worst = int(squares.argmax())
        limit = MAX_SIGMA**2 * max(float(np.median(squares)) / MEDIAN_CHI2, 1.0)
        if len(G) == min_views or squares[worst] < limit:
            break
        G = np.delete(G, worst, axis=0)
        y = np.delete(y, worst, axis=0)
    total = float(squares.sum() + state[3:] @ sigmas.shared_information @ state[3:])
    scale = max(total / max(3 * len(G) - 3, 1), 1.0)
    covariance = np.asarray(scale * np.linalg.inv(information)[:3, :3], dtype=np.float64)
    return MeasuredTable(centre, state[:3], covariance)


def refuse_doubtful_table(table: MeasuredTable, planes: Sequence[ViewPlane | None]) -> None:
    """Raise TableElsewhereError if the table is too far from where it is given, or another plane may be the table.

    Args:
        table: Measured table.
        planes: Plane of the table in each view; None for a view that shows too little of it.
    """
    shown = [plane for plane in planes if plane is not None]
    if sum(plane.has_rival for plane in shown) > len(shown) / 2:
        raise TableElsewhereError(
            f"{describe_table(table)}, and another plane above it: neither is where the table is given, so it is not "
            "known which is the table. Correct table_z_m, or remove the large flat object"
        )
    if abs(table.height_m) > MAX_HEIGHT_M or table.tilt_rad > MAX_TILT_RAD:
        raise TableElsewhereError(
            f"{describe_table(table)}, more than {MAX_HEIGHT_M * 1000:.0f} mm or {np.degrees(MAX_TILT_RAD):.0f} "
            "degrees: correct table_z_m, level the table, or calibrate if the table is where it is given"
        )


def describe_table(table: MeasuredTable) -> str:
    """Return where the table is, as the beginning of a message."""
    side = "higher" if table.height_m > 0 else "lower"
    return (
        f"the views show the table {abs(table.height_m) * 1000:.1f} mm {side} than given and tilted by "
        f"{np.degrees(table.tilt_rad):.2f} degrees"
    )


def is_near(T_a: NDArray[np.float64], T_b: NDArray[np.float64], planes: Sequence[ViewPlane | None]) -> bool:
    """Return whether two motions (4, 4) of the table give nearly the same plane where the views show it."""
    normal_a = T_a[:3, 2]
    normal_b = T_b[:3, 2]
    if float(np.linalg.norm(np.cross(normal_a, normal_b))) > MAX_NEAR_RAD:
        return False
    centres = np.array([plane.centre for plane in planes if plane is not None]).reshape(-1, 3)
    difference = transform_points(T_a, centres) - transform_points(T_b, centres)
    return len(centres) == 0 or abs(float(difference[:, 2].mean())) < MAX_NEAR_M


def _equations(
    planes: Sequence[ViewPlane], centre: NDArray[np.float64], sigmas: PoseSigmas
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return (G, y): the errors of view k are `G[k] @ state - y[k]`, in sigmas, with the shapes (V, 3, 12) and (V, 3).

    The state is the offset of the table (3), the hand-eye error (6) and the disparity error (3).
    """
    heights = [plane.height_at(centre[:2]) - centre[2] for plane in planes]
    slope_x, slope_y = np.array([plane.slope for plane in planes]).T
    measured = np.column_stack([slope_y, -slope_x, heights])
    T = np.array([plane.T_base_camera for plane in planes])
    R = T[:, :3, :3]
    lever = centre - T[:, :3, 3]
    # The true plane is the measured one moved by the pose error, a twist about the camera.
    by_pose = np.zeros((len(planes), 3, 6))
    by_pose[:, :2, :2] = np.eye(2)
    by_pose[:, 2, :3] = -cross_matrix(lever)[:, 2]
    by_pose[:, 2, 5] = 1.0
    # A disparity error moves a point along its ray. The derivative of the height is the tilt.
    axes = disparity_axes(R)
    along = np.einsum("vai,vi->va", axes, lever)
    by_disparity = np.stack([axes[:, :, 1], -axes[:, :, 0], along], axis=1) * lever[:, 2, None, None]
    G = np.zeros((len(planes), 3, 3 + N_SHARED))
    G[:, :, :3] = np.eye(3)
    G[:, :, 3:6] = -by_pose[..., :3] @ R
    G[:, :, 6:9] = -by_pose[..., 3:] @ R
    G[:, :, 9:] = -by_disparity
    robot = np.repeat([sigmas.robot_rad, sigmas.robot_m], 3) ** 2
    fit = np.array([sigmas.table_rad, sigmas.table_rad, sigmas.table_m]) ** 2
    covariance = by_pose * robot @ by_pose.swapaxes(1, 2) + np.diag(fit)
    whitening = np.linalg.inv(np.linalg.cholesky(covariance))
    weighted: NDArray[np.float64] = np.einsum("vij,vj->vi", whitening, measured)
    return np.asarray(whitening @ G, dtype=np.float64), weighted
