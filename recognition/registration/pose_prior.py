"""Gaussian prior of the camera poses.

The true camera pose of view k is `E_k T_base_flange T_flange_camera E_h`. Each view has its own robot error E_k. All
views share the hand-eye error E_h (camera frame) and the disparity error of the stereo camera: an offset, and a slope
along the columns and the rows of the image. A plane that is measured with such an error is another plane. The alignment
of a view to the table plane (`recognition.preprocessing.table_plane`) has measured three of the six directions of its
pose.

The state of V views has 6 V + 9 entries: one twist for each view about a common centre (6 V), the twist of the hand-eye
error in the camera frame (6), and the disparity error (3: offset, slope along the columns, slope along the rows). A
twist has the order rotation (rad), then translation (m).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from calibration.geometry.se3 import adjoint, cross_matrix
from calibration.geometry.transforms import from_rotation_vector
from recognition.preprocessing.normals import NormalCloud

N_DISPARITY = 3
"""Number of state entries of the disparity error, the last ones."""
N_SHARED = 6 + N_DISPARITY
"""Number of state entries that all views share: hand-eye error (6) and disparity error (3)."""
DISPARITY_OFFSET_PX = 0.1
"""Standard deviation of the disparity offset of a camera whose disparities are known, pixels."""
DISPARITY_SLOPE_PX = 0.15
"""Standard deviation of its slope, pixels per unit of the tangent of the viewing angle. Rectification errors of 0.15
pixels (root mean square) that change slowly over the image have slopes of 0.1 to 0.16."""
OFFSET_FIT_POINTS = 50
"""Approximate number of points in the fit of a twist to the effect of a disparity error."""


@dataclass(frozen=True)
class PoseSigmas:
    """Standard deviations of the pose errors, per axis. The 3D rms error is sqrt(3) times larger."""

    robot_m: float = 0.0003
    """Position error of the flange, metres, independent in each view (0.5 mm rms in 3D)."""
    robot_rad: float = 0.001
    """Rotation error of the flange, radians, independent in each view (0.1 degrees rms in 3D)."""
    hand_eye_m: float = 0.0004
    """Position error of the camera on the flange, metres, equal in all views (0.7 mm rms in 3D)."""
    hand_eye_rad: float = 0.0015
    """Rotation error of the camera on the flange, radians, equal in all views (0.15 degrees rms in 3D)."""
    disparity_per_m: float = 0.002
    """Depth error divided by the squared depth, 1/m, equal in all views. The default is a disparity offset of 0.1
    pixels at a baseline of 75 mm and a focal length of 800 pixels."""
    disparity_slope_per_m: float = 1e-5
    """Slope of that error over the image, 1/m per unit of the tangent of the viewing angle, equal in all views. The
    default is practically none."""
    table_m: float = 0.00015
    """Height error of a view that was aligned to the table plane, metres."""
    table_rad: float = 0.0015
    """Tilt error of a view that was aligned to the table plane, radians. Stereo errors bend the measured plane."""

    @classmethod
    def for_disparities(cls, per_pixel_m: float | None) -> "PoseSigmas":
        """Return the sigmas for a camera: its disparity errors in pixels, but at least the defaults.

        Args:
            per_pixel_m: Inverse depth of one pixel of disparity, 1/m: 1 / (focal length in pixels times baseline). None
                if it is unknown, for the defaults.
        """
        if per_pixel_m is None:
            return cls()
        return cls(
            disparity_per_m=max(DISPARITY_OFFSET_PX * per_pixel_m, cls.disparity_per_m),
            disparity_slope_per_m=max(DISPARITY_SLOPE_PX * per_pixel_m, cls.disparity_slope_per_m),
        )

    @property
    def shared_information(self) -> NDArray[np.float64]:
        """(9, 9) prior information matrix of hand-eye error (rotation, then translation) and disparity error."""
        hand_eye = np.repeat([self.hand_eye_rad, self.hand_eye_m], 3)
        disparity = (self.disparity_per_m, self.disparity_slope_per_m, self.disparity_slope_per_m)
        return np.diag(np.append(hand_eye, disparity) ** -2.0)


@dataclass(frozen=True, eq=False)
class PosePrior:
    """Gaussian prior of the state (6 V + 9 entries), in information form."""

    information: NDArray[np.float64]
    """(6 V + 9, 6 V + 9) information matrix (inverse covariance)."""
    gradient: NDArray[np.float64]
    """(6 V + 9,) gradient of the cost at the zero state. The mean x of the prior solves `information x = -gradient`."""
    robot_errors: tuple[tuple[NDArray[np.float64], NDArray[np.float64]], ...]
    """(D, d) for each view. The robot error of the view at the state x is `D x + d` (6,), in sigmas."""


def pose_prior(clouds: Sequence[NormalCloud], centre: NDArray[np.float64], sigmas: PoseSigmas) -> PosePrior:
    """Return the Gaussian prior of the pose corrections of all views.

    Args:
        clouds: The V views. The pose of a view already includes its `NormalCloud.T_correction`. If a view has no
            `T_base_camera`, its pose error rotates about `centre`.
        centre: (3,) rotation centre of the twists of the views, metres, base frame.
        sigmas: Standard deviations of the pose errors.

    Returns:
        The prior of the state with 6 V + 9 entries.
    """
    size = 6 * len(clouds) + N_SHARED
    information = np.zeros((size, size))
    information[-N_SHARED:, -N_SHARED:] = sigmas.shared_information
    gradient = np.zeros(size)
    per_sigma = np.repeat([1 / sigmas.robot_rad, 1 / sigmas.robot_m], 3)
    robot_errors = []
    for k, cloud in enumerate(clouds):
        own = twist_entries(k)
        T = cloud.T_base_camera
        if T is None:
            T = from_rotation_vector(centre, np.zeros(3))
        rotation = np.kron(np.eye(2), T[:3, :3])
        # Convert a twist about the centre to a twist about the camera, because the errors are defined at the camera.
        to_camera = adjoint(from_rotation_vector(centre - T[:3, 3], np.zeros(3)))
        D = np.zeros((6, size))
        D[:, own] = to_camera
        D[:, -N_SHARED:-N_DISPARITY] = -rotation
        if cloud.T_base_camera is not None:
            D[:, -N_DISPARITY:] = to_camera @ _disparity_twists(cloud.points, T, centre)
        D *= per_sigma[:, None]
        d = per_sigma * (to_camera @ twist_about(cloud.T_correction, centre))
        information += D.T @ D
        gradient += D.T @ d
        if not np.array_equal(cloud.T_correction, np.eye(4)):
            table = np.array([sigmas.table_rad, sigmas.table_rad, np.inf, np.inf, np.inf, sigmas.table_m])
            information[own, own] += np.diag(table**-2.0)
        robot_errors.append((D, d))
    return PosePrior(information, gradient, tuple(robot_errors))


def twist_entries(view: int) -> slice:
    """Return the entries of the state that are the twist of a view, by its list index."""
    return slice(6 * view, 6 * view + 6)


def given_pose_covariance(cloud: NormalCloud, centre: NDArray[np.float64], sigmas: PoseSigmas) -> NDArray[np.float64]:
    """Return the covariance (6, 6) of the pose error of a single view whose table shows nothing about it.

    Args:
        cloud: The view.
        centre: (3,) rotation centre of the twist, metres, base frame.
        sigmas: Standard deviations of the pose errors. Those of the table are not used.
    """
    prior = pose_prior([cloud], centre, replace(sigmas, table_m=np.inf, table_rad=np.inf))
    return np.asarray(np.linalg.inv(prior.information)[:6, :6], dtype=np.float64)


def twist_about(T: NDArray[np.float64], centre: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the twist (6,) of `T` (4, 4): its rotation vector, and its displacement of the point `centre` (3,)."""
    return np.concatenate([Rotation.from_matrix(T[:3, :3]).as_rotvec(), T[:3, :3] @ centre + T[:3, 3] - centre])


def disparity_axes(R: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the axes (..., 3, 3) of offset, slope along the columns and slope along the rows, one a row.

    A unit of each error moves a point, seen from the camera along a vector, by this vector times its component along
    the axis: an offset by the depth, a slope by the depth times the tangent of the viewing angle.

    Args:
        R: Rotations (..., 3, 3) of the cameras, camera to base.
    """
    return np.stack([R[..., 2], R[..., 0], R[..., 1]], axis=-2)


def _disparity_twists(
    points: NDArray[np.float64], T: NDArray[np.float64], centre: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the twists (6, 3) that best approximate the effects of unit disparity errors on points (N, 3).

    `T` (4, 4) is the camera pose, and `centre` (3,) is the rotation centre of the twist.
    """
    p = points[:: max(len(points) // OFFSET_FIT_POINTS, 1)]
    rays = p - T[:3, 3]
    along = rays @ disparity_axes(T[:3, :3]).T
    displacements = rays[:, :, None] * along[:, None, :]
    # Rows of the Jacobian [-(p - centre) x, I] of each point with respect to the twist.
    by_rotation = -cross_matrix(p - centre)
    A = np.concatenate([by_rotation, np.broadcast_to(np.eye(3), by_rotation.shape)], axis=2).reshape(-1, 6)
    b = displacements.reshape(-1, N_DISPARITY)
    return np.asarray(np.linalg.lstsq(A.T @ A, A.T @ b, rcond=None)[0], dtype=np.float64)
